"""What a killed node does to the others of the graph, and how soon it is back, by what Fast DDS is told.

.venv/bin/python docs/decisions/middleware.py        (about four minutes)
"""

import json
import os
import statistics
import subprocess
import sys
import tempfile
from itertools import pairwise
from pathlib import Path

from missions.case_studies.driven_graph import driven_graph
from missions.case_studies.kill_trials import run_kill_trial
from missions.case_studies.live_faults import study_plan
from missions.case_studies.live_series import between
from strap_rover.ros_shell.middleware import PROFILE, RANGE

ROUNDS = 3
VARIANTS = ("as rmw_fastrtps has it", "announcing 4 times a second", "that, and UDP only (chosen)")
KILLED = ("recorder", "strap_sensor_driver", "traction_controller")
BYSTANDERS = {"recorder": ("commands", "wheels", "truths"), "strap_sensor_driver": ("wheels", "truths"),
              "traction_controller": ("wheels", "truths")}  # fmt: skip
"""What should be heard on while a node is away."""
WATCHED_NS = 4_000_000_000
ANNOUNCING = """<?xml version="1.0" encoding="UTF-8"?>
<profiles xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
  <participant profile_name="announcing" is_default_profile="true"><rtps><builtin><discovery_config>
    <leaseAnnouncement><sec>0</sec><nanosec>250000000</nanosec></leaseAnnouncement>
  </discovery_config></builtin></rtps></participant>
</profiles>
"""


def measure() -> None:
    """One variant, as the environment has it: the rows as JSON on stdout."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for number in range(ROUNDS):
            with driven_graph(study_plan(0.1, 0.0, number), Path(folder) / str(number)) as driven:
                for node in KILLED:
                    driven.forget()
                    trial = run_kill_trial(driven, node)
                    started_ns = round(1e9 * driven.graph.nodes[node].started_s)
                    killed_ns = started_ns - round(1e6 * trial.to_start_ms)
                    silences = []
                    for name in BYSTANDERS[node]:
                        heard = between(getattr(driven.series, name), killed_ns, killed_ns + WATCHED_NS)
                        times = [killed_ns, *(one.at_ns for one in heard)]
                        silences.append(max(after - at for at, after in pairwise(times)) / 1e6)
                    back_ms = trial.start_to_message_ms if trial.drove_on else trial.start_to_driving_ms
                    rows.append((node, back_ms, max(silences)))
    print(json.dumps(rows))


def environment_of(variant: str, folder: Path) -> dict[str, str]:
    """What the processes of a variant are told."""
    environment = {name: value for name, value in os.environ.items() if name not in {PROFILE, RANGE}}
    environment[RANGE] = "LOCALHOST"
    if variant == VARIANTS[0]:
        environment[PROFILE] = ""  # a wish of the user's own, which is none
    elif variant == VARIANTS[1]:
        path = folder / "announcing.xml"
        path.write_text(ANNOUNCING, encoding="utf-8")
        environment[PROFILE] = str(path)
    return environment


def main() -> None:
    print("| Fast DDS | killed | new process to driving [ms], median / max | longest silence of the others [ms] |")
    print("| --- | --- | ---: | ---: |")
    with tempfile.TemporaryDirectory() as folder:
        for variant in VARIANTS:
            done = subprocess.run(
                [sys.executable, __file__, "measure"],
                env=environment_of(variant, Path(folder)),
                stdout=subprocess.PIPE,
                check=True,
                text=True,
            )
            rows = json.loads(done.stdout.splitlines()[-1])
            for node in KILLED:
                back = [row[1] for row in rows if row[0] == node and row[1] is not None]
                silence = [row[2] for row in rows if row[0] == node]
                spread = f"{statistics.median(back):.0f} / {max(back):.0f}" if back else "never"
                print(
                    f"| {variant} | {node} | {spread} | {statistics.median(silence):.0f} / {max(silence):.0f} |",
                    flush=True,
                )


if __name__ == "__main__":
    measure() if sys.argv[1:] == ["measure"] else main()
