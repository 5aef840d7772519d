"""What ROS tools draw of a pause: clouds, transforms, markers, grids and camera, as messages.

Recorder and publisher of the program import it; it imports grids, the robot, `files` and transport's messages.
"""
