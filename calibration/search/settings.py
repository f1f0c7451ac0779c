"""How a minimum is looked for: by which optimiser, of which loss, from how many starts."""

from dataclasses import dataclass

from calibration.search import optimise, robust


@dataclass(frozen=True)
class SearchSettings:
    """How a search is done; `max_iterations`: evaluations of each start."""

    optimiser: str
    loss: str
    starts: int
    seed: int
    max_iterations: int


@dataclass(frozen=True)
class SearchOptions:
    """What a user may choose of a search, as for `calibration.calibrate`.

    `optimiser` and `max_iterations` are None where the usual ones are wanted. Raises `ValueError`
    for values that are not allowed.
    """

    optimiser: str | None = None
    loss: str = "squares"
    starts: int = 1
    seed: int = 0
    max_iterations: int | None = None

    def __post_init__(self):
        if self.optimiser is not None and self.optimiser not in optimise.OPTIMISERS:
            choices = ", ".join(optimise.OPTIMISERS)
            raise ValueError(f"optimiser={self.optimiser!r}: choose from {choices}")
        if self.loss not in robust.LOSSES:
            raise ValueError(f"loss={self.loss!r}: choose from {', '.join(robust.LOSSES)}")
        for name in ("max_iterations", "starts"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise ValueError(f"{name}={value}: at least 1 is needed")

    def settings(self, parameters: int) -> SearchSettings:
        """The settings, with what is usual for so many parameters where nothing was chosen."""
        optimiser = self.optimiser or optimise.usual(parameters)
        _, most = optimise.OPTIMISERS[optimiser]
        if self.max_iterations is not None:
            most = self.max_iterations
        return SearchSettings(optimiser, self.loss, self.starts, self.seed, most)
