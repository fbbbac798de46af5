"""The Dynamixel length unit of the spine."""
