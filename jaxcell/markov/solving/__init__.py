"""Linear equations of chains."""
