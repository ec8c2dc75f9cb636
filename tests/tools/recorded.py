"""Recordings read back as they are, component by component."""

import rerun as rr


def flat(values):
    """Numbers of an arrow array."""
    while str(values.type).startswith(("fixed_size_list", "list")):
        values = values.flatten()
    return values.to_numpy(zero_copy_only=False)


class Recorded:
    """A recording: values of each component by frame or iteration, None where static."""

    def __init__(self, path, timelines=("frame", "iteration")):
        self.rows = {}
        for chunk in rr.chunk.RrdReader(path).stream().to_chunks():
            batch = chunk.to_record_batch()
            entity = batch.schema.metadata[b"rerun:entity_path"].decode()
            times = [name for name in timelines if name in batch.schema.names]
            at = batch.column(times[0]).to_pylist() if times else [None] * len(batch)
            for name in batch.schema.names:
                if ":" in name:
                    column = batch.column(name)
                    found = self.rows.setdefault(entity, {}).setdefault(
                        name.split(":")[1], {}
                    )
                    found |= {
                        k: column[i].values
                        for i, k in enumerate(at)
                        if column[i].is_valid
                    }

    def numbers(self, entity, component):
        """Values of a component, by frame or iteration."""
        rows = sorted(self.rows[entity][component].items())
        return {k: flat(values) for k, values in rows}

    def at(self, entity, component, k):
        return flat(self.rows[entity][component][k])

    def text(self, entity, component, k):
        return self.rows[entity][component][k][0].as_py()
