"""evo and `monoslam evaluate` say the same of a trajectory that this package has written."""

from __future__ import annotations

import json
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from conftest import Mapped, program

EVO_APE = Path(sys.executable).parent / "evo_ape"


@pytest.fixture(scope="module")
def estimate(mapped: Mapped, tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("evo") / "estimate.txt"
    mapped.client.trajectory(mapped.id).save_tum(file)
    return file


def evaluated(truth: Path, estimate: Path, *options: str) -> dict[str, float]:
    command = [program("monoslam"), "evaluate", truth, estimate, "--json", *options]
    last = subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()[-1]
    figures: dict[str, float] = json.loads(last)
    return figures


def by_evo(truth: Path, estimate: Path, folder: Path, *options: str) -> dict[str, float]:
    results = folder / "ape.zip"
    results.unlink(missing_ok=True)
    command = [EVO_APE, "tum", truth, estimate, *options, "--save_results", results]
    subprocess.run(command, check=True, capture_output=True, env={"HOME": str(folder)})
    with zipfile.ZipFile(results) as archive:
        stats: dict[str, float] = json.loads(archive.read("stats.json"))
    return stats


@pytest.mark.parametrize(("ours", "theirs"), [("sim3", ["--align", "--correct_scale"]), ("se3", ["--align"])])
def test_evo_ape_is_monoslam_evaluate(
    room_path: Path, estimate: Path, tmp_path: Path, ours: str, theirs: list[str]
) -> None:
    truth = room_path / "groundtruth.txt"
    evo, monoslam = by_evo(truth, estimate, tmp_path, *theirs), evaluated(truth, estimate, "--align", ours)
    print(f"\n{ours}: evo_ape {evo['rmse']:.12f}, monoslam evaluate {monoslam['ate_rmse']:.12f}")
    for name in ["rmse", "mean", "median", "max"]:
        assert monoslam[f"ate_{name}"] == pytest.approx(evo[name], rel=1e-6), name
    assert ours != "sim3" or monoslam["ate_rmse"] < 0.05


def test_our_file_is_the_server_s(mapped: Mapped, estimate: Path, tmp_path: Path) -> None:
    theirs = tmp_path / "theirs.txt"
    command = [program("monoslam"), "trajectory", mapped.id, "--server", mapped.server.address, "-o", theirs]
    subprocess.run([*command, "--format", "tum", "--kind", "frames"], check=True, capture_output=True)
    numbers = [[line.split() for line in file.read_text().splitlines()] for file in (estimate, theirs)]
    assert [row[0] for row in numbers[0]] == [row[0] for row in numbers[1]]
    assert [[float(x) for x in row] for row in numbers[0]] == [[float(x) for x in row] for row in numbers[1]]
