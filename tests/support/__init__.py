"""What tests share: scenes, results, commands, independent solutions, forged files, pools of workers."""

import pytest

# So that a failing helper shows the values that it compared, as tests do.
pytest.register_assert_rewrite(*(f"support.{name}" for name in ("commands", "oracle", "scenes", "searches", "workers")))
