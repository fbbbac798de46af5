"""A Universal Robots controller in a process of its own: arm, control script, RTDE stream, upload and dashboard."""
