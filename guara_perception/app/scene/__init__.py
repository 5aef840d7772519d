"""ROS messages of a pause for viewers: clouds, transforms, markers, grids and camera.

The node, the demo and the views import it; it imports none of them.
"""
