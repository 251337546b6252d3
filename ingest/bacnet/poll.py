"""The one module that touches the BACnet library: ask devices, turn answers into samples."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from fdd.records import Batch, Quality, Sample
from ingest.bacnet.options import BacnetOptions

_FAULT, _OUT_OF_SERVICE = 1, 3  # bits of Status_Flags (ASHRAE 135, 12.2.7)


class Poller:
    """Reads present values and status flags; must be made and used inside one event loop."""

    def __init__(self, options: BacnetOptions, objects: Mapping[str, Sequence[str]]) -> None:
        """``objects``: device to object identifiers such as ``analog-input,3``.

        Raises
        ------
        OSError : the own address cannot be bound.
        ImportError : the BACnet library is not installed.
        """
        from bacpypes3.ipv4.app import NormalApplication
        from bacpypes3.local.device import DeviceObject
        from bacpypes3.pdu import Address, IPv4Address
        from bacpypes3.vendor import get_vendor_info

        own_address = IPv4Address(options.address)
        _require_free(*own_address.addrTuple)
        self._options, self._objects = options, objects
        self._addresses = {name: Address(address) for name, address in options.devices.items()}
        self._vendor = get_vendor_info(0)
        own = DeviceObject(
            objectIdentifier=("device", options.device_id),
            objectName="hvac-fdd",
            vendorIdentifier=999,
            maxApduLengthAccepted=1024,
            segmentationSupported="segmented-both",
        )
        self._application = NormalApplication(own, own_address)
        self.counts: dict[str, int] = {}

    async def poll(self, now: Callable[[], int]) -> Batch:
        """One sample of every object, with the time of its answer; no value where none came."""
        samples: list[Sample] = []
        for device, objects in self._objects.items():
            for start in range(0, len(objects), self._options.objects_per_request):
                part = objects[start : start + self._options.objects_per_request]
                values = await self._read(device, part)
                time = now()
                for name in part:
                    value, quality = values.get(name, (None, Quality.BAD))
                    samples.append(Sample(f"{device}/{name}", time, value, quality))
        return Batch.of(samples)

    async def _read(self, device: str, objects: Sequence[str]) -> dict[str, tuple[float | None, Quality]]:
        wanted: list[Any] = []
        for name in objects:
            wanted += [name, ["present-value", "status-flags"]]
        request = self._application.read_property_multiple(self._addresses[device], wanted, vendor_info=self._vendor)
        try:
            answer = await asyncio.wait_for(request, self._options.timeout)
        except TimeoutError:
            self._count("device did not answer", len(objects))
            return {}
        if not isinstance(answer, list):
            self._count("request refused by device", len(objects))
            return {}
        return self._sorted(answer)

    def _sorted(self, answer: list[Any]) -> dict[str, tuple[float | None, Quality]]:
        values: dict[str, float | None] = {}
        bad: set[str] = set()
        for (kind, instance), what, _, value in answer:
            name = f"{kind},{instance}"
            if str(what) == "present-value":
                values[name] = self._number(value)
            elif _flagged(value):
                bad.add(name)
        return {name: (value, Quality.BAD if name in bad else Quality.GOOD) for name, value in values.items()}

    def _number(self, value: Any) -> float | None:
        try:
            return float(value)
        except (TypeError, ValueError, OverflowError):
            self._count("object without a number", 1)
            return None

    def _count(self, reason: str, number: int) -> None:
        self.counts[reason] = self.counts.get(reason, 0) + number

    def close(self) -> None:
        """Give the address back."""
        self._application.close()


def _require_free(host: str, port: int) -> None:
    """The library binds in the background and only logs a failure, so try first."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind((host, port))


def _flagged(flags: Any) -> bool:
    try:
        bits = list(flags)
        return bool(bits[_FAULT] or bits[_OUT_OF_SERVICE])
    except (TypeError, IndexError):
        return False  # an object without the property is no worse for it
