from .charging import Charged as Charged, charged as charged
from .division import (
    Division as Division,
    divide_graph as divide_graph,
    part_of_graph as part_of_graph,
    walk_in_part as walk_in_part,
)
from .durations import Timed as Timed, timed as timed
from .idleness import (
    Idleness as Idleness,
    long_run as long_run,
    simulate_idleness as simulate_idleness,
    steps_between_visits as steps_between_visits,
)
from .news import News as News, age_of_news as age_of_news
from .rounds import (
    Round as Round,
    evenly_spaced_round as evenly_spaced_round,
    round_on_map as round_on_map,
    walk_around as walk_around,
)
from .times import time_unit_of as time_unit_of, whole_times as whole_times
