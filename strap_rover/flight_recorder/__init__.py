"""The flight recorder: bags as ROS 2 Jazzy's rosbag2 writes them, recorded from the graph and read back."""
