"""Recordings, read back from their files."""

import re
import tempfile
from pathlib import Path

import numpy as np
from rerun.chunk import RrdReader

from jaxcell.record import save_recording


class Recording:
    """The content of a recording, read back from its file."""

    def __init__(self, path):
        reader = RrdReader(path)
        self.size = Path(path).stat().st_size
        self.application = reader.recordings()[0].application_id
        self.chunks = reader.stream().to_chunks()
        # The last value of each column of an entity of the blueprint.
        self.blueprint = {}
        for store in reader.blueprints():
            for chunk in reader.stream(store=store).to_chunks():
                values = self.blueprint.setdefault(chunk.entity_path, {})
                values |= {name: column[-1] for name, column in columns(chunk)}
        self.entities = {chunk.entity_path for chunk in self.chunks}
        self.timelines = {name for chunk in self.chunks for name in chunk.timeline_names}

    def static(self, entity, column):
        """The one value of a column that has no time."""
        ((value,),) = self._columns(entity, column, None)
        return value

    def over(self, timeline, entity, column):
        """The values of a column by time, from all chunks; later rows win."""
        rows = {}
        for times, values in self._columns(entity, column, timeline):
            rows |= dict(zip(times, values, strict=True))
        return rows

    def pictures(self, timeline, entity):
        """The pictures of an entity by time."""
        buffers = self.over(timeline, entity, "SegmentationImage:buffer")
        formats = self.over(timeline, entity, "SegmentationImage:format")
        return {time: _picture(buffers[time], formats[time]) for time in buffers}

    def picture(self, entity):
        """The picture of an entity that is the same at all times."""
        buffer = self.static(entity, "SegmentationImage:buffer")
        return _picture(buffer, self.static(entity, "SegmentationImage:format"))

    def classes(self, entity):
        """The labels of the classes of pictures, in order."""
        (context,) = self.static(entity, "AnnotationContext:context")
        assert [one["class_id"] for one in context] == list(range(len(context)))
        return [one["class_description"]["info"]["label"] for one in context]

    def labels(self, entity, timeline=None):
        """The label of each pixel of a picture, or of the pictures by time."""
        labels = np.array(self.classes(entity))
        if timeline is None:
            return labels[self.picture(entity)]
        return {time: labels[one] for time, one in self.pictures(timeline, entity).items()}

    def text(self, entity="/text"):
        """The whole text of a tab; its sections are under its entity."""
        parts = sorted(one for one in self.entities if re.fullmatch(rf"{entity}/\d+", one))
        return "\n\n".join(self.static(one, "TextDocument:text")[0] for one in parts)

    def poses(self, entity, timeline="step"):
        """The origins and the unit headings of arrows by time, side by side."""
        origins = self.over(timeline, entity, "Arrows2D:origins")
        vectors = self.over(timeline, entity, "Arrows2D:vectors")
        poses = {}
        for time, origin in origins.items():
            vector = np.array(vectors[time]).reshape(-1, 2)
            vector /= np.linalg.norm(vector, axis=1, keepdims=True)
            poses[time] = np.concatenate([np.array(origin).reshape(-1, 2), vector], axis=1)
        return poses

    def _columns(self, entity, column, timeline):
        for chunk in self.chunks:
            batch = chunk.to_record_batch()
            if chunk.entity_path == entity and column in batch.schema.names:
                values = batch.column(column).to_pylist()
                if timeline is None and chunk.is_static:
                    yield values
                elif timeline in batch.schema.names:
                    # Seconds are durations, in nanoseconds.
                    yield batch.column(timeline).cast("int64").to_pylist(), values


def columns(chunk):
    """The names and the values of the columns of a chunk, without times."""
    batch = chunk.to_record_batch()
    return [(one, batch.column(one).to_pylist()) for one in batch.schema.names if ":" in one]


def _picture(buffer, layout):
    (layout,) = layout
    return np.array(buffer[0], np.uint8).reshape(layout["height"], layout["width"])


def packed(color):
    """A colour as Rerun stores it."""
    return int.from_bytes(bytes(color if len(color) == 4 else (*color, 255)))


def poses_of(cells, where):
    """The centres and the unit headings of cells, side by side."""
    x, y, theta = cells.centre(np.array(where, int))
    return np.stack([x, y, np.cos(theta), np.sin(theta)], axis=1)


def written(write, *arguments, **options):
    """The recording that a function writes to a file."""
    with tempfile.TemporaryDirectory() as folder:
        write(path := Path(folder, "result.rrd"), *arguments, **options)
        return Recording(path)


def read_back(result, spec=None):
    """The recording of a result."""
    return written(lambda path: save_recording(result, path, spec=spec))
