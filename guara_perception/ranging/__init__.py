"""Ranging: from stripe positions to points in the robot's frame and to range images."""
