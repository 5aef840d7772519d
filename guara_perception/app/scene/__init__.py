"""ROS messages of a pause for viewers: clouds, transforms, markers, grids and camera.

Recorder and publisher of the program import it; it imports grids, the robot, `files` and transport's messages.
"""
