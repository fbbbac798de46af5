"""The Robotiq FT300-S force sensor."""
