"""A BACnet/IP device and the source, both real, on two loopback addresses."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterator
from socket import SOCK_DGRAM
from typing import Any

import numpy as np
import pytest
from bacpypes3.ipv4.app import NormalApplication
from bacpypes3.local.analog import AnalogInputObject
from bacpypes3.local.binary import BinaryInputObject
from bacpypes3.local.device import DeviceObject
from bacpypes3.pdu import IPv4Address

from fdd.records import Batch, Quality
from ingest.bacnet import BacnetOptions, BacnetSource
from ingest.source import Context, NotReady, Refused
from tests.ports import free_port


async def _serve(port: int, ready: threading.Event, stop: threading.Event) -> None:
    device = DeviceObject(
        objectIdentifier=("device", 100),
        objectName="air handler",
        vendorIdentifier=999,
        maxApduLengthAccepted=1024,
        segmentationSupported="segmented-both",
    )
    application = NormalApplication(device, IPv4Address(f"127.0.0.1:{port}"))
    common = {"eventState": "normal", "statusFlags": [0, 0, 0, 0], "outOfService": False}
    for i in range(60):
        application.add_object(
            AnalogInputObject(
                objectIdentifier=("analog-input", i),
                objectName=f"AI{i}",
                presentValue=20.0 + i,
                units="percent",
                **common,
            )
        )
    broken = AnalogInputObject(
        objectIdentifier=("analog-input", 99),
        objectName="AI99",
        presentValue=1.0,
        units="percent",
        reliability="no-sensor",  # from which the library derives the fault flag
        **common,
    )
    application.add_object(broken)
    application.add_object(
        BinaryInputObject(
            objectIdentifier=("binary-input", 1), objectName="fan", presentValue="active", polarity="normal", **common
        )
    )
    ready.set()
    while not stop.is_set():
        await asyncio.sleep(0.02)
    application.close()


@pytest.fixture
def device() -> Iterator[str]:
    port, ready, stop = free_port(kind=SOCK_DGRAM), threading.Event(), threading.Event()
    thread = threading.Thread(target=lambda: asyncio.run(_serve(port, ready, stop)))
    thread.start()
    assert ready.wait(10)
    yield f"127.0.0.1:{port}"
    stop.set()
    thread.join(10)


def _source(devices: dict[str, str], columns: tuple[str, ...], **options: Any) -> BacnetSource:
    source = BacnetSource(now=iter(range(10**6)).__next__)
    table = {
        "address": f"127.0.0.2:{free_port('127.0.0.2', SOCK_DGRAM)}",
        "devices": devices,
        "interval": "0.2 s",
        **options,
    }
    source.configure(BacnetOptions.model_validate(table), Context(columns=columns))
    return source


def _poll(stream: Iterator[Batch]) -> Batch:
    """The next poll; batches without samples only say that time goes on."""
    return next(batch for batch in stream if len(batch))


def test_values_of_many_objects_arrive_poll_after_poll(device: str) -> None:
    columns = (*(f"ahu/analog-input,{i}" for i in range(60)), "ahu/binary-input,1")
    source = _source({"ahu": device}, columns)
    source.open()
    stream = source.batches()
    polls = [_poll(stream) for _ in range(2)]
    source.close()
    for poll in polls:
        assert poll.names == columns
        np.testing.assert_allclose(poll.value, [*(20.0 + i for i in range(60)), 1.0])
        assert not poll.quality.any()
    assert polls[1].time.min() > polls[0].time.max()
    assert source.counters() == {"polls": 2}


def test_missing_objects_faults_and_silent_devices_are_counted_and_the_rest_goes_on(device: str) -> None:
    silent = f"127.0.0.3:{free_port('127.0.0.3', SOCK_DGRAM)}"
    columns = ("ahu/analog-input,0", "ahu/analog-input,77", "ahu/analog-input,99", "away/analog-input,1")
    source = _source({"ahu": device, "away": silent}, columns, timeout="5 s")
    source.open()
    poll = _poll(source.batches())
    counters = source.counters()
    source.close()
    got = dict(zip([poll.names[p] for p in poll.point], zip(poll.value, poll.quality, strict=True), strict=True))
    assert got["ahu/analog-input,0"] == (20.0, Quality.GOOD)
    assert np.isnan(got["ahu/analog-input,77"][0])
    assert got["ahu/analog-input,99"][1] == Quality.BAD
    assert np.isnan(got["away/analog-input,1"][0])
    assert counters["object without a number"] == 1
    assert counters["device did not answer"] == 1


def test_column_that_names_no_device_is_refused_before_any_network() -> None:
    with pytest.raises(Refused, match="with a device of: ahu"):
        _source({"ahu": "10.0.0.1"}, ("analog-input,3",))


def test_own_address_that_is_not_ours_is_not_ready() -> None:
    source = _source({"ahu": "127.0.0.1"}, ("ahu/analog-input,3",), address="203.0.113.7:47808")
    with pytest.raises(NotReady, match="cannot be bound"):
        source.open()
    source.close()
