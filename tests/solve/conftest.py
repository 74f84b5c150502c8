"""Plates of these tests run in groups wherever many others would."""

import pytest


@pytest.fixture(autouse=True)
def _groups_at_once(monkeypatch):
    monkeypatch.setattr("warp_plate.solve.cpu.GROUP_WORK", 0)
