"""A robot without hardware, which moves in a map and speaks the Open Interface."""
