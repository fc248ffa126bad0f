from .canvas.map import on_squares as on_squares
