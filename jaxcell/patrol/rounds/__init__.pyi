from .bounding import Bound as Bound, bound as bound
from .drawn import DrawnSchedules as DrawnSchedules, best_mixture as best_mixture
from .evaluation import Evaluation as Evaluation, evaluate as evaluate
from .game import Game as Game, is_game as is_game, load_game as load_game, save_game as save_game
from .guarded import Guarded as Guarded
from .mixing import best_routes as best_routes
from .route import (
    Route as Route,
    load_routes as load_routes,
    save_routes as save_routes,
    save_timetable as save_timetable,
)
from .search import Rounds as Rounds, best_rounds as best_rounds
