"""The commands of our studies."""

from .. import study
from .study import command


Cover = command(study.Cover)
PatrolMap = command(study.PatrolMap)
