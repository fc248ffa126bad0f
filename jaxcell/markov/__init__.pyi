from . import dense as dense
from .arrival import (
    Distinct as Distinct,
    first_arrival as first_arrival,
)
from .conditional import (
    arrival_probabilities as arrival_probabilities,
    conditional_hitting_times as conditional_hitting_times,
)
from .decision import DecisionModel as DecisionModel, policy_chain as policy_chain
from .discounted import Optimum as Optimum, value_iteration as value_iteration
from .estimation import (
    ChapmanKolmogorov as ChapmanKolmogorov,
    Spread as Spread,
    chapman_kolmogorov as chapman_kolmogorov,
    maximum_likelihood as maximum_likelihood,
    posterior as posterior,
)
from .hitting import (
    Absorption as Absorption,
    absorption_probabilities as absorption_probabilities,
    absorption_times as absorption_times,
    hitting_times as hitting_times,
)
from .likely_path import most_probable_path as most_probable_path
from .limiting import (
    LimitingDistribution as LimitingDistribution,
    limiting_distribution as limiting_distribution,
)
from .mean_arrival import (
    MeanArrival as MeanArrival,
    mean_first_arrival as mean_first_arrival,
)
from .passage import first_passage as first_passage
from .passage_times import (
    passage_quantiles as passage_quantiles,
    passage_time_variance as passage_time_variance,
)
from .quantities import (
    commute_times as commute_times,
    entropy_rate as entropy_rate,
    hitting_matrix as hitting_matrix,
    kemeny_constant as kemeny_constant,
    mixing_time as mixing_time,
    slem as slem,
)
from .quasi import (
    QuasiStationary as QuasiStationary,
    quasi_stationary as quasi_stationary,
)
from .sets.modes import Modes as Modes, leading_modes as leading_modes
from .sets.nearly_closed import (
    NearlyClosedSets as NearlyClosedSets,
    almost_invariant_sets as almost_invariant_sets,
    attracting_regions as attracting_regions,
    coherent_sets as coherent_sets,
)
from .shortest_path import (
    ShortestPath as ShortestPath,
    stochastic_shortest_path as stochastic_shortest_path,
)
from .simulation import Arrivals as Arrivals, simulate_arrival as simulate_arrival
from .transition_paths import (
    ReactiveFlux as ReactiveFlux,
    committor as committor,
    reactive_flux as reactive_flux,
)
from .undiscounted import (
    Average as Average,
    average_reward as average_reward,
    finite_horizon as finite_horizon,
)
from .visited import (
    Exits as Exits,
    exit_distribution as exit_distribution,
    visits as visits,
)
from .walks import sample_walks as sample_walks
