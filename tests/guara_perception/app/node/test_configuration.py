"""Monitor of the files with which a node was started."""

from pathlib import Path

from guara_perception.app.node.configuration import ConfigurationWatch
from transport import Health


def test_changed_new_and_deleted_files_are_named(tmp_path: Path) -> None:
    """Changes in a folder and in a single file are named; unchanged files are not."""
    calibration, folder = tmp_path / "calibration.json", tmp_path / "rex"
    (folder / "urdf").mkdir(parents=True)
    for path in (calibration, folder / "robot.toml", folder / "urdf" / "rex.urdf"):
        path.write_text("a")
    watch = ConfigurationWatch(calibration, None, folder)
    assert watch.item().level is Health.OK
    calibration.write_text("another")
    (folder / "urdf" / "rex.urdf").unlink()
    (folder / "new.toml").write_text("")
    item = watch.item()
    assert item.level is Health.WARN and "restart the node to apply the changes" in item.message
    for path in (calibration, folder / "urdf" / "rex.urdf", folder / "new.toml"):
        assert str(path) in item.message
    assert "robot.toml" not in item.message.replace("new.toml", "")
