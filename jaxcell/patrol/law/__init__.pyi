from .distribution import Gld as Gld
from .fit import GldFit as GldFit, fit_gld as fit_gld
