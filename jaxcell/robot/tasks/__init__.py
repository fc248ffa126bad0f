"""The tasks of robots, as files: filters, plans, policies and patrols."""
