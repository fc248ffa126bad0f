"""The driver of an iRobot Create 2 or Roomba 600: its serial line, commands and sensors."""
