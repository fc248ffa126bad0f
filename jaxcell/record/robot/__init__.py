"""Recordings of robots that are driven."""

from .recording import RobotRecording as RobotRecording
from .track import RecordedRobot as RecordedRobot
