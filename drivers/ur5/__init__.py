"""The UR5 arm: its motion by ur-rtde, its state by a stream of its own."""
