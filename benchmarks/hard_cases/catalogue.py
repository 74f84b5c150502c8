"""All hard cases, in the order of the table."""

from hard_cases import energies, insides, limits, odd, scales
from hard_cases.case import Case

CASES: list[Case] = [*limits.CASES, *energies.CASES, *scales.CASES, *insides.CASES, *odd.CASES]
