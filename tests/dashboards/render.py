"""What Grafana does to a Flux query before it sends it: variables replaced, ``v`` given, after the imports."""

from __future__ import annotations

import re
from collections.abc import Mapping

_VARIABLE = re.compile(r"\$\{(\w+)(?::(\w+))?\}")


def render(flux: str, variables: Mapping[str, str], *, bucket: str, start: int, stop: int, window: str = "10m") -> str:
    """The query as the server gets it; an unknown variable or format fails."""

    def value(found: re.Match[str]) -> str:
        name, form = found.groups()
        if form == "doublequote":
            return '"' + variables[name].replace('"', '\\"') + '"'
        assert form is None, f"format {form} of ${name}"
        return variables[name]

    text = _VARIABLE.sub(value, flux)
    option = (
        f"option v = {{timeRangeStart: time(v: {start}), timeRangeStop: time(v: {stop}), "
        f'windowPeriod: {window}, defaultBucket: "{bucket}"}}'
    )
    lines = text.split("\n")
    imports = [line for line in lines if line.startswith("import ")]
    return "\n".join([*imports, option, *(line for line in lines if not line.startswith("import "))])
