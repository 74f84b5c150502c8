"""``--set KEY=VALUE`` on the commands that take a scene."""

import json
from inspect import signature

import pytest
from conftest import output_of

from warp_plate.cli.commands import COMMANDS, app


def test_every_command_of_a_scene_sets_its_keys():
    commands = {name: signature(app[name].default_command).parameters for name in COMMANDS.split()}
    scenes = [name for name, parameters in commands.items() if "scene" in parameters]
    assert len(scenes) > 8
    assert [name for name in scenes if "assignments" not in commands[name]] == []


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
