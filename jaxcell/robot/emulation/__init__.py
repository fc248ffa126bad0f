"""An emulated robot, which moves in a map and speaks the Open Interface."""
