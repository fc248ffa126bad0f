"""The driver of an iRobot Create 2 or Roomba 600: its line, its commands and its sensors."""
