"""Short names of alarms: the component and the number of its alarm, ``hx.2``, for hands and for narrow screens."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from fdd.records import JsonObject
from fdd.service.site.errors import UsageError


def handles(alarms: Sequence[JsonObject]) -> dict[str, str]:
    """Key of each alarm to its handle; alarms of a component are numbered in the order in which they were raised."""
    counted: Counter[str] = Counter()
    found = {}
    for alarm in sorted(alarms, key=lambda a: (int(a["raised"]), str(a["key"]))):
        counted[alarm["component"]] += 1
        found[str(alarm["key"])] = f"{alarm['component']}.{counted[alarm['component']]}"
    return found


def key_of(said: str, alarms: Sequence[JsonObject], *, among: Sequence[JsonObject] | None = None) -> str:
    """The key that is meant by a key, a handle, or the name of a component with one alarm among ``among``.

    Raises
    ------
    UsageError : none or several are meant; the text lists what there is
    """
    names = handles(alarms)
    among = alarms if among is None else among
    keys = {str(a["key"]) for a in among}
    meant = [k for k, handle in names.items() if k in keys and said in (k, handle)]
    meant = meant or [str(a["key"]) for a in among if a["component"] == said]
    if len(meant) == 1:
        return meant[0]
    known = ", ".join(names[k] for k in names if k in keys) or "none"
    raise UsageError(f"{'no' if not meant else 'more than one'} alarm is meant by {said!r}; there are: {known}")
