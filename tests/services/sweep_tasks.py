"""What the workers of a sweep are asked to do in tests: functions that another process can import."""

from __future__ import annotations

import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nuno_bench import stability
from nuno_bench.stability import measure_setting
from nuno_schemas.errors import BadInput


def square(number: int) -> int:
    if number < 0:
        raise BadInput("negative", field="number", value=number)
    return number * number


def divide(number: int) -> float:
    return 1.0 / number


def die_at_first(task: tuple[str, int]) -> int:
    """Ends its process once for each file that is not there yet; a name with "always" ends it every time."""
    mark, number = Path(task[0]), task[1]
    if number == 2 and (not mark.exists() or mark.name == "always"):
        with mark.open("a") as stream:
            stream.write("x")
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def tell_process(mark: str) -> None:
    """Writes which process it runs in, and does not end."""
    Path(mark).with_suffix(".part").write_text(str(os.getpid()))
    Path(mark).with_suffix(".part").rename(mark)
    time.sleep(600.0)


@dataclass(frozen=True)
class Dying:
    """Measures a setting's rows; the first process that is given a soft one ends, and leaves a mark."""

    mark: str

    def __call__(self, task: stability.Task) -> Any:
        if task.setting.value < 0.5 and not Path(self.mark).exists():
            Path(self.mark).touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return measure_setting(task)
