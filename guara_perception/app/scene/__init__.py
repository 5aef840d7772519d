"""ROS messages of a pause for viewers: clouds, transforms, markers, grids and camera.

The node, the demo and the views import this package; it imports none of them.
"""
