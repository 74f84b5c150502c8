"""Results in the formats of other programs."""

from typing import Literal

Format = Literal["vtkhdf", "traces-csv", "drive-wav", "drive-csv"]
