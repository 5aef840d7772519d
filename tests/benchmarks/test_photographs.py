"""The figures on photographs of real laser lines, where they are at hand."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.photographs import Counts, judge, main, means, product

FOLDER = Path(__file__).resolve().parents[3] / "shared" / "data" / "photographs"


@pytest.mark.heavy
@pytest.mark.skipif(not FOLDER.is_dir(), reason="the photographs are not part of the repository")
def test_stripes_of_real_lasers_are_found_without_laser_off_pictures() -> None:
    """Families of cameras and rooms count alike."""
    families = judge(FOLDER, product, with_off=False)
    coverage, gross, filled = means(families)
    assert coverage >= 0.94
    assert gross <= 0.05
    assert filled <= 0.12
    assert min(counts.coverage for counts in families.values()) >= 0.78


def test_positions_are_counted_as_the_truth_says() -> None:
    """Right within three pixels, gross far beyond; what is returned in a gap is counted apart."""
    nan = np.nan
    counts = Counts()
    counts.add(
        np.array([10.0, 14.0, nan, 5.0, 9.0]),
        must=np.array([11.0, 10.0, 10.0, nan, nan]),
        may=np.array([11.0, 10.0, 10.0, 20.0, nan]),
        gap=np.array([False, False, False, False, True]),
    )
    assert (counts.seen, counts.right, counts.gross, counts.gaps, counts.filled) == (3, 1, 2, 1, 1)
    assert counts.coverage == pytest.approx(1 / 3)
    assert counts.gross_share == pytest.approx(2 / 3)


def test_a_folder_without_photographs_is_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing is measured and nothing fails."""
    monkeypatch.setattr("sys.argv", ["photographs", str(tmp_path)])
    main()
    assert "nothing was measured" in capsys.readouterr().out
