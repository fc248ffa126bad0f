"""The tasks of robots that are stored in files: filters, plans, policies and patrols."""
