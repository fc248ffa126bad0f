import dataclasses

import tyro


@dataclasses.dataclass(frozen=True, kw_only=True)
class Run:
    """Run a study of your own; `jaxcell run FILE.py:CLASS --help` shows its options."""

    study: tyro.conf.Positional[str]
    """The class, FILE.py:CLASS or MODULE:CLASS, which derives from jaxcell.study.Study."""

    def run(self) -> int:
        raise ValueError(f"{self.study}: expected FILE.py:CLASS or MODULE:CLASS")
