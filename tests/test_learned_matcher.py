"""The documentation's network, where PyTorch is installed: it is no dependency."""

from pathlib import Path

import numpy as np
import pytest

from harness.runs.load import load_experiment
from harness.testing.conformity import CHECKS, Subject, examine

FILES = Path(__file__).parent.parent / "docs" / "how-to" / "files"


@pytest.mark.slow
def test_the_network_of_the_page_is_a_matcher(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Before it is trained, too: it begins as block matching."""
    torch = pytest.importorskip("torch")
    monkeypatch.syspath_prepend(FILES)
    import stereo_net

    torch.save(stereo_net.StereoNet().state_dict(), tmp_path / "stereo_net.pt")
    (tmp_path / "learned.toml").write_text((FILES / "learned.toml").read_text(encoding="utf-8"), encoding="utf-8")
    trials = [each.trial for each in load_experiment(tmp_path / "learned.toml").planned]
    assert len(trials) == 12
    (network,) = {each.matching.kind: each.matching for each in trials if "stereo_net" in each.matching.kind}.values()
    subject = Subject(network)
    chosen = [check for check in CHECKS if check.name in {"answers", "shape", "angles", "mixed-up", "missing", "easy"}]
    assert [(check.name, examine(subject, check).passed) for check in chosen] == [
        (check.name, True) for check in chosen
    ]
    assert np.isfinite(subject.matches("easy").alpha_2).mean() > 0.9
