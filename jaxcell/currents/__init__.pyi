from .ocean import open_currents as open_currents
