"""Lines of a kind's readers that its corpus reaches: `python -m nuno_bench.soak.fuzz.covered KIND FOLDER`."""

from __future__ import annotations

import contextlib
import importlib.util
import sys
import warnings
from pathlib import Path


def main(name: str, folder: Path) -> None:
    """Read all that the search kept, once more; write the share of the modules' lines to `lines` [%]."""
    import coverage

    measured = coverage.Coverage(data_file=None, config_file=False)
    measured.start()
    from nuno_bench.soak.fuzz.kinds import KINDS

    kind = KINDS[name]
    warnings.simplefilter("ignore")
    read = kind.reader(folder)
    for path in sorted((folder / "corpus").iterdir()):
        # What is found is counted by the worker; here it must not end the count.
        with contextlib.suppress(Exception):
            read(path.read_bytes())
    measured.stop()
    lines = missing = 0
    for module in kind.modules:
        spec = importlib.util.find_spec(module)
        assert spec is not None
        _, statements, _, unreached, _ = measured.analysis2(str(spec.origin))
        lines, missing = lines + len(statements), missing + len(unreached)
    (folder / "lines").write_text(repr(100.0 * (lines - missing) / lines))


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
