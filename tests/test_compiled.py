"""When compiled loops are used, and what happens without numba or a cache folder."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from seqid_cli import compiled
from seqid_cli.motion.block_filter import BlockLowpass
from seqid_cli.robot.regressor import torque_regressor
from tests.robot.robots import random_model, states

needs_numba = pytest.mark.skipif(find_spec("numba") is None, reason="numba is not installed")
PATH = str(Path(__file__).parents[1])
LONG = 10.0 * compiled.LEAST_S

KERNEL = """
from seqid_cli.compiled import compiled, inlined

@inlined
def half(x):
    return 0.5 * x

@compiled("f8(f8)")
def kernel(x):
    return half(x) + 1.0
"""


@needs_numba
def test_only_long_work_is_worth_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(compiled.SWITCH, raising=False)
    assert compiled.worth(LONG)
    assert not compiled.worth(0.1 * compiled.LEAST_S)
    assert compiled.worth_for_rows(3_600_000, 7)  # an hour at 1 kHz
    assert not compiled.worth_for_rows(60_000, 7)


@pytest.mark.parametrize("value", ["0", " 0 "])
def test_the_environment_switches_them_off(value: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(compiled.SWITCH, value)
    assert not compiled.available()
    assert not compiled.worth(LONG)


def test_without_numba_numpy_does_all(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiled, "find_spec", lambda name: None)
    rng = np.random.default_rng(1)
    _, chain = random_model(rng, [False, True])
    state = states(rng, 40, 2)
    plain = torque_regressor(chain, np.ones(3), *state, use_compiled=False)
    np.testing.assert_array_equal(
        torque_regressor(chain, np.ones(3), *state, use_compiled=True), plain
    )
    rows = np.cumsum(rng.normal(size=(3, 900)), axis=1)
    asked, plainly = rows.copy(), rows.copy()
    BlockLowpass(10.0, 500.0).filter_rows(asked, use_compiled=True)
    BlockLowpass(10.0, 500.0).filter_rows(plainly, use_compiled=False)
    np.testing.assert_array_equal(asked, plainly)
    assert not compiled.worth(LONG)


def test_a_numba_that_cannot_be_imported_is_not_used(tmp_path: Path) -> None:
    (tmp_path / "numba.py").write_text("raise ImportError('numpy is too new')")
    code = "from seqid_cli import compiled; assert not compiled.worth(1e9)"
    paths = os.pathsep.join([str(tmp_path), PATH])
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": paths},
        capture_output=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


def fresh(home: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """Compile and run a function in a process that has this home folder."""
    (home / "made_here.py").write_text(KERNEL)
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("NUMBA_", "XDG_", "SEQID_"))}
    return subprocess.run(
        [sys.executable, "-c", "import made_here; print(made_here.kernel(3.0))"],
        env={**kept, "HOME": str(home), "PYTHONPATH": PATH + os.pathsep + str(home), **environment},
        capture_output=True,
        text=True,
        check=False,
        cwd=home,
    )


@needs_numba
@pytest.mark.skipif(os.name != "posix", reason="folders of a home differ")
def test_machine_code_is_kept_in_the_users_cache(tmp_path: Path) -> None:
    done = fresh(tmp_path, XDG_CACHE_HOME=str(tmp_path / "cache"))
    assert done.returncode == 0, done.stderr
    assert float(done.stdout) == 2.5
    folder = tmp_path / "cache" / "seqid" / "compiled"
    assert list(folder.rglob("*.nbi"))
    assert not folder.stat().st_mode & 0o022
    assert not list((tmp_path / "__pycache__").glob("*.nbi"))


@needs_numba
@pytest.mark.skipif(os.name != "posix", reason="folders of a home differ")
def test_a_cache_that_cannot_be_used_is_done_without(tmp_path: Path) -> None:
    (tmp_path / "cache").write_text("a file where a folder should be")
    done = fresh(tmp_path, XDG_CACHE_HOME=str(tmp_path / "cache"))
    assert done.returncode == 0, done.stderr
    assert float(done.stdout) == 2.5


@pytest.mark.skipif(os.name != "posix", reason="permissions differ")
def test_a_folder_that_others_may_write_to_is_not_trusted(tmp_path: Path) -> None:
    folder = tmp_path / "seqid" / "compiled"
    assert compiled.private(folder)
    folder.chmod(0o777)
    assert not compiled.private(folder)


def test_a_cache_folder_is_absolute_or_not_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    found = compiled.cache_folder()
    assert found is None or found.is_absolute()


def test_numba_is_not_imported_for_short_work() -> None:
    code = (
        "import sys; import numpy as np\n"
        "from seqid_cli.motion.block_filter import BlockLowpass\n"
        "import seqid_cli.robot.base\n"
        "BlockLowpass(10.0, 500.0).filter_rows(np.ones((3, 900)))\n"
        "assert 'numba' not in sys.modules\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=False)
    assert done.returncode == 0, done.stderr
