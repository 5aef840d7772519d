"""ROS messages of a pause for viewers: clouds, transforms, markers, grids and camera.

The node, the demo, the views and the commands import this package; it imports none of them.
"""
