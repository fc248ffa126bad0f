from .model import (
    Maximin as Maximin,
    Movement as Movement,
    Perimeter as Perimeter,
    detection_polynomials as detection_polynomials,
    hitting_law as hitting_law,
    maximin as maximin,
    mean_hitting_times as mean_hitting_times,
)
