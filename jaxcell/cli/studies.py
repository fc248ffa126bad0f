"""The commands of our studies."""

from .. import study
from .study import command


Cover = command(study.Cover)
Drift = command(study.Drift)
Drifters = command(study.Drifters)
Dynamics = command(study.Dynamics)
Groups = command(study.Groups)
Localize = command(study.Localize)
Navigate = command(study.Navigate)
PatrolGraph = command(study.PatrolGraph)
PatrolMap = command(study.PatrolMap)
Team = command(study.Team)
