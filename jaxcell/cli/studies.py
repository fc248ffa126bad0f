"""The commands of our studies."""

from .. import study
from .study import command


Cover = command(study.Cover)
Navigate = command(study.Navigate)
PatrolGraph = command(study.PatrolGraph)
Team = command(study.Team)
