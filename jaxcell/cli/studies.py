"""The commands of our studies."""

from .. import study
from .study import command


Cover = command(study.Cover)
Navigate = command(study.Navigate)
Team = command(study.Team)
