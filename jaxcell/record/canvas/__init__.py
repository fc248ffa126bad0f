"""The parts of which all recordings are made.

- `stream`: the file, and what the viewer opens with.
- `map`: a map with y up, pictures of its cells, and views of it.
- `scale`: numbers as colours, with their classes and their legend.
- `marks`: labels, frames, dots, arrows and trails.
- `curves`: numbers over a timeline. `plot`: charts of bars and curves in a plane.
- `page`: a tab of views with a legend and a text.
- `palette`: the colours. `prose`: pieces of the texts.
"""
