"""``--set KEY=VALUE`` on the commands that take a scene."""

import json
from inspect import signature

import pytest

from support.commands import output_of
from warp_plate.cli.main import COMMANDS, application


def test_every_command_of_a_scene_sets_its_keys():
    apps = {name: application()[name] for name in COMMANDS}
    options = {name: [option.name for option in app.assemble_argument_collection()] for name, app in apps.items()}
    scenes = [name for name, app in apps.items() if "scene" in signature(app.default_command).parameters]
    assert len(scenes) > 8
    assert [name for name in scenes if "--set" not in options[name]] == []


def test_results_bear_what_was_set(command, tmp_path):
    options = ("--device", "cpu", "--no-pictures", "--no-estimate", "--out", tmp_path / "a.h5", "--json")
    found = json.loads(output_of(command("simulate", "paper", "--set", "drive.frequency=300", *options)))
    bare = json.loads(output_of(command("simulate", "paper", *options)))
    assert found["scene"] == "paper --set drive.frequency=300"
    assert found["energy"]["plate"] != pytest.approx(bare["energy"]["plate"], rel=1e-2)


def test_a_search_that_is_resumed_takes_no_new_keys(command):
    status, _, error = command("localize", "--resume", "a.checkpoint.h5", "--set", "drive.frequency=300")
    assert status == 2
    assert "an unfinished search has its own" in error
