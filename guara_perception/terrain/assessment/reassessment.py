"""`Reassessment`: the layers of a grid that grows column by column, judged again only where something changed."""

from __future__ import annotations

from guara_perception.arrays import Array, Flags
from guara_perception.settings import TraversabilityLimits
from guara_perception.terrain.assessment.assess import completed, flags_of, judge_discs, judge_soles
from guara_perception.terrain.assessment.columns import changed_columns, runs, widened
from guara_perception.terrain.assessment.disc import disc_kernel
from guara_perception.terrain.assessment.raster import Raster


class Reassessment:
    """Gives what `assess_layers` gives, to the last bit.

    Discs are fitted again only where something within them changed; soles and clearance take little time.
    """

    def __init__(self, resolution: float, limits: TraversabilityLimits) -> None:
        """Start with nothing judged.

        Args:
            resolution: cell edge [m].
            limits: what the feet can bear.
        """
        self._resolution, self._limits = resolution, limits
        self._kernel = disc_kernel(limits.disc_radius / resolution)
        self._before: tuple[Raster, Flags, dict[str, Array]] | None = None

    def layers(self, raster: Raster, hazard: Flags) -> dict[str, Array]:
        """All layers that follow from the heights; arguments and result as those of `assess_layers`.

        The arrays must not be changed afterwards: they are what the next ones are compared with.
        """
        flags = flags_of(raster, hazard)
        tested = self._tested(raster, flags)
        self._before = raster, flags, tested
        return completed(judge_soles(tested, self._kernel, self._resolution, self._limits), self._resolution)

    def _tested(self, raster: Raster, flags: Flags) -> dict[str, Array]:
        """The layers that follow from the discs."""
        fixed = self._kernel, self._resolution, self._limits
        if self._before is None:
            return judge_discs(raster, flags, *fixed)
        raster_before, flags_before, before = self._before
        changed = changed_columns(flags, flags_before)
        for now, then in zip(raster.layers, raster_before.layers, strict=True):
            changed |= changed_columns(now, then)
        reach = self._kernel.shape[0] // 2
        parts = []
        # Only a column whose discs meet a change can change; it is judged with all the columns that its discs touch.
        for columns in runs(widened(changed, reach)):
            first = max(columns.start - reach, 0)
            around = slice(first, columns.stop + reach)
            part = judge_discs(raster.window((slice(None), around)), flags[:, around], *fixed)
            parts.append((columns, slice(columns.start - first, columns.stop - first), part))
        if not parts:
            return before
        tested = {name: layer.copy() for name, layer in before.items()}
        for columns, inner, part in parts:
            for name, layer in tested.items():
                layer[:, columns] = part[name][:, inner]
        return tested
