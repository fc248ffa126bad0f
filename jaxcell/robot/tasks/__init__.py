"""Tasks of robots, stored in files: filters, plans, policies and patrols."""
