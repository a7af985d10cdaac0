"""The simulated world: terrain, plant, sensors and the virtual boards behind the very interfaces of a rover."""
