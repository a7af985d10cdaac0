"""A made-up drive, as an observer would have heard it: two boards, six wheels, times in ms."""

import numpy as np
import pytest

from missions.case_studies.live_series import (
    AnglesHeard,
    FrameHeard,
    GraphSeries,
    HealthHeard,
    SoilHeard,
    SpeedsHeard,
    StateHeard,
)
from strap_sensor_driver.contact_zone import ContactAngles, ContactStatus
from strap_sensor_driver.frames import DataFrame, FrameDecoder, encode_data
from traction_controller.supervisor import Fault

MS = 1_000_000


class Drive:
    """Say what happens from when to when; everything comes at its usual rate."""

    def __init__(self):
        self.series = GraphSeries()

    def frames(self, board, from_ms, until_ms, seq=0):
        for number, at_ms in enumerate(range(from_ms, until_ms, 5)):
            frame = DataFrame(board, seq + number, 5000 * (seq + number), 0, 4, (1,) * 6)
            (event,) = FrameDecoder().feed(encode_data(frame))
            self.series.add_frame(FrameHeard(at_ms * MS, board, event.payload))
        return self

    def commands(self, from_ms, until_ms, radps):
        self.series.commands += [SpeedsHeard(at_ms * MS, radps) for at_ms in range(from_ms, until_ms, 10)]
        return self

    def wheels(self, from_ms, until_ms, begin_radps, end_radps=None):
        times = range(from_ms, until_ms, 10)
        end_radps = begin_radps if end_radps is None else end_radps
        values = np.linspace(begin_radps, end_radps, len(times)).tolist()
        self.series.wheels += [SpeedsHeard(at * MS, value) for at, value in zip(times, values, strict=True)]
        return self

    def angles(self, from_ms, until_ms, *status):
        codes = np.array([int(code) for code in (*status, *[ContactStatus.VALID] * (6 - len(status)))])
        for at_ms in range(from_ms, until_ms, 10):
            record = ContactAngles(at_ms * MS, *[np.zeros(6)] * 4, codes)
            self.series.angles.append(AnglesHeard(at_ms * MS, record))
        return self

    def soils(self, from_ms, until_ms):
        self.series.soils += [SoilHeard(at_ms * MS) for at_ms in range(from_ms, until_ms, 20)]
        return self

    def state(self, at_ms, fault):
        self.series.states.append(StateHeard(at_ms * MS, Fault(fault)))
        return self

    def health(self, at_ms, board, node="strap_sensor_driver", **values):
        said = {name: str(value) for name, value in ({"line": "RUNNING"} | values).items()}
        self.series.health.append(HealthHeard(at_ms * MS, node, f"board {board}", "", said))
        return self


@pytest.fixture
def drive():
    return Drive()
