"""Wheel-soil laws: pure functions of numbers, no state, no ROS.

`soil` names soils, `contact` balances a wheel on them, `slip` says how much it spins, `spiral_flow` where the
soil goes.
"""
