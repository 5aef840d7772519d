"""Makes docs/foxglove-layout.json with the classes that Foxglove publishes for layouts: what they refuse is not in it.

Run with `foxglove-sdk` installed: `python tests/interop/foxglove_layout.py docs/foxglove-layout.json`.
"""

import json
import sys
from pathlib import Path

from foxglove import layouts

ROBOT = "guara"
ON_AND_OFF = ("on", "off")


def layout() -> layouts.Layout:
    """Robot, fused map, stripes and markers in odom; the camera's pictures and the diagnostics beside them."""
    shown = {
        f"/{ROBOT}/map/points": layouts.BaseRendererPointCloudTopicSettings(
            visible=True, color_mode="rgb", color_field="rgb", point_size=5.0, point_shape="square"
        ),
        f"/{ROBOT}/scan/points": layouts.BaseRendererPointCloudTopicSettings(
            visible=True, color_mode="colormap", color_field="sigma", color_map="turbo", point_size=1.5
        ),
        f"/{ROBOT}/markers": layouts.BaseRendererRosMarkerTopicSettings(visible=True),
        "/robot_description": layouts.BaseRendererUrdfTopicSettings(visible=True, display_mode="visual"),
    }
    space = layouts.ThreeDeePanel(
        config=layouts.ThreeDeeConfig(
            topics=shown,
            fixed_frame="odom",
            follow_tf="base_footprint",
            follow_mode="follow-position",
            camera_state=layouts.ThreeDeeCameraState(distance=2.2, phi=60.0, theta_offset=50.0, perspective=True),
        )
    )
    pictures = [
        layouts.ImagePanel(
            config=layouts.ImageConfig(
                image_mode=layouts.ImageModeConfig(
                    image_topic=f"/{ROBOT}/camera/{kind}/compressed",
                    calibration_topic=f"/{ROBOT}/camera/camera_info",
                )
            )
        )
        for kind in ON_AND_OFF
    ]
    status = layouts.DiagnosticsSummaryPanel(
        config=layouts.DiagnosticsSummaryConfig(topic_to_render=f"/{ROBOT}/status")
    )
    beside = layouts.SplitContainer(
        direction="column", items=[layouts.SplitItem(proportion=1.0, content=panel) for panel in (*pictures, status)]
    )
    return layouts.Layout(
        content=layouts.SplitContainer(
            direction="row",
            items=[
                layouts.SplitItem(proportion=0.7, content=space),
                layouts.SplitItem(proportion=0.3, content=beside),
            ],
        )
    )


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(json.dumps(json.loads(layout().to_json()), indent=2) + "\n")
