"""What every room of the house may use."""
