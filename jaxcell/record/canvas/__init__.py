"""Elements that all recordings share.

- `stream`: the file, and the layout of the viewer.
- `map`: a map with y up, pictures of its cells, robots, frames, and views of it.
- `scale`: colours for numbers, with their classes and their legend.
- `marks`: labels, dots, arrows, lines and trails.
- `curves`: curves of numbers over a timeline. `plot`: charts of bars and curves in a plane.
- `page`: a tab of views with a legend and a text.
- `palette`: the colours. `prose`: sentences and tables for texts in Markdown.
"""
