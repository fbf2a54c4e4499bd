"""A run's name stays in its folder, and a saved run takes changes of what it has."""

import pytest
import yaml

from rrl.trainers.cli.compose import compose, compose_train, plain_name


@pytest.mark.parametrize("name", ["../up", "/etc", "a/b", "..", ".hidden", "", "a b"])
def test_a_name_stays_in_its_folder(name):
    with pytest.raises(ValueError, match="name: expected letters"):
        plain_name(name)


def test_an_escaping_run_has_no_directory():
    with pytest.raises(ValueError, match="escaped"):
        compose_train(["name=../../escaped"], None)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        (
            "disturbance=bias",
            r"disturbance: expected a change .*disturbance\..*, got disturbance=bias",
        ),
        ("logger=[csv]", r"logger: expected a change .*, got logger=\[csv\]"),
        ("hydra.run.dir=elsewhere", r"^hydra\.run\.dir: .* got elsewhere; .* copy it"),
    ],
)
def test_a_saved_run_has_no_groups_and_goes_nowhere_else(tmp_path, override, message):
    (tmp_path / "config.yaml").write_text(yaml.safe_dump(compose([])))
    with pytest.raises(ValueError, match=message):
        compose_train([override], tmp_path)
    assert compose_train(["logger=null"], tmp_path).config["logger"] is None
