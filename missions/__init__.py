"""The roof: whole runs with and without ROS, what came of them, case studies and the `strap_rover` command line."""
