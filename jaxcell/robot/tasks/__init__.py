"""What a robot does, as files: filters, plans, policies and patrols."""
