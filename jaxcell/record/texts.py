from .canvas.prose import describe as describe, made_with as made_with
