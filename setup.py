"""The ament_python package `strap_rover`: Python packages, installed data, executables."""

from pathlib import Path

from setuptools import find_packages, setup

PACKAGE = "strap_rover"
ROOT = Path(__file__).parent


def files_below(folder: str, *patterns: str) -> list[tuple[str, list[str]]]:
    """One data_files row per directory below `folder` that has such files, under share/strap_rover."""
    rows: dict[str, list[str]] = {}
    for pattern in patterns:
        for path in sorted((ROOT / folder).rglob(pattern)):
            relative = path.relative_to(ROOT)
            rows.setdefault(f"share/{PACKAGE}/{relative.parent}", []).append(str(relative))
    return list(rows.items())


setup(
    name=PACKAGE,
    version="0.1.0",
    packages=find_packages(
        include=[
            name
            for top in (
                "strap_rover",
                "strap_sensor_driver",
                "soil_flow_estimator",
                "traction_controller",
                "sim_bridge",
                "missions",
            )
            for name in (top, f"{top}.*")
        ]
    ),
    package_data={"missions.report": ["page.css", "page.js"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml", "LICENSE"]),
        *files_below("config", "*.yaml", "*.rules", "*.urdf", "*.xml"),
        *files_below("launch", "*.launch.py"),
    ],
    python_requires=">=3.11",
    # Lower bounds only (Ubuntu 24.04's versions); requirements/core.txt pins. rclpy and the message packages come
    # with ROS 2, or from the extra `ros`.
    install_requires=[
        "numpy>=1.26",
        "scipy>=1.11",
        "numba>=0.58",
        "pyserial>=3.5",
        "mcap>=1.2",
        "zstandard>=0.22",
        "PyYAML>=6.0",
        "rich>=13",
        "matplotlib>=3.6",
    ],
    extras_require={
        "ros": ["ros-rclpy[fastrtps]==7.1.6", "ros-jazzy-rclpy", "ros-jazzy-common-interfaces"],
        "test": ["pytest", "pytest-xdist", "hypothesis", "rosbags", "mcap-ros2-support"],
        "report": ["plotly>=6"],  # before, its JavaScript read no packed numbers
        "granular": ["lammps", "mpi4py"],
        "campaign": ["dask[distributed]", "pyarrow"],
    },
    zip_safe=True,
    maintainer="strap_rover developers",
    maintainer_email="strap-rover@users.noreply.github.com",
    description="Resistive-strap contact sensing, soil-flow estimation and traction control for rover wheels on sand.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "strap_rover = missions.command_line:main",
            "strap_sensor_driver = missions.node_processes:strap_sensor_driver",
            "soil_flow_estimator = missions.node_processes:soil_flow_estimator",
            "traction_controller = missions.node_processes:traction_controller",
            "sim_bridge = missions.node_processes:sim_bridge",
            "recorder = missions.node_processes:recorder",
            "player = missions.node_processes:player",
        ],
    },
)
