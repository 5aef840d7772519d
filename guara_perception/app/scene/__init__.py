"""What ROS tools draw of a pause: clouds, transforms, markers, grids and camera, as messages.

Recorder and publisher of the program import it; it imports grids, the robot and transport's messages.
"""
