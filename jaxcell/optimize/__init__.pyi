from .commute import MinimumCommute as MinimumCommute, minimum_commute as minimum_commute
from .constraints import Linear as Linear
from .cover import (
    Cover as Cover,
    LargestCover as LargestCover,
    MinimumCover as MinimumCover,
    greedy_cover as greedy_cover,
    largest_cover as largest_cover,
    minimum_cover as minimum_cover,
)
from .game import Commitment as Commitment, stackelberg as stackelberg
from .graph import Graph as Graph, GraphLike as GraphLike
from .mixing import FastestMixing as FastestMixing, fastest_mixing as fastest_mixing
from .mixtures import Mixture as Mixture, mixture as mixture
from .stakes import Stakes as Stakes, payoffs as payoffs
from .tour import shortest_tour as shortest_tour
