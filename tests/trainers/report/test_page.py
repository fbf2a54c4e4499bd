"""A page is one file that holds everything, shows what it was given, and is safe to open."""

import re

import imageio.v3 as iio
import numpy as np
import plotly.graph_objects as go
import pytest

from browser import needs_chromium, opened
from rrl.trainers.report.page import Page

HOSTILE = "</script><script>document.title='broken'</script> & <b>"


@pytest.fixture
def page(tmp_path):
    page = Page(f"A page {HOSTILE}")
    page.section("First & foremost")
    page.text(f"Some `code` and {HOSTILE}")
    page.table(["name", "value"], [["a", "1"], [HOSTILE, "2"]])
    iio.imwrite(tmp_path / "picture.png", np.zeros((8, 8, 3), dtype=np.uint8))
    frames = np.zeros((4, 32, 32, 3), dtype=np.uint8)
    iio.imwrite(tmp_path / "video.mp4", frames, fps=4, codec="libx264")
    iio.imwrite(tmp_path / "video.gif", frames)
    page.image(tmp_path / "picture.png", "a black square")
    page.section("Moving")
    page.video(tmp_path / "video.mp4")
    page.video(tmp_path / "video.gif")
    page.chart(go.Figure(go.Scatter(x=[0, 1], y=[1, 2], name=HOSTILE)), f"a line {HOSTILE}")
    page.chart(go.Figure(go.Bar(x=["a", "b"], y=[1, 2])))
    page.details("everything", HOSTILE)
    return page


def test_nothing_is_loaded_from_elsewhere_and_plotly_is_there_once(page, tmp_path):
    source = page.write(tmp_path / "new" / "page.html").read_text()
    assert not re.findall(
        r"""<(?:script|link|img|video|iframe)[^>]*(?:src|href)=["'](?!data:)""", source
    )
    assert source.count("plotly.js v") == 1
    assert not list((tmp_path / "new").glob(".*"))


def test_a_page_without_charts_is_small(tmp_path):
    page = Page("Plain")
    page.text("only text, 5 $ and $title")
    source = page.write(tmp_path / "page.html").read_text()
    assert len(source) < 10_000
    assert "5 $ and $title" in source


def test_a_row_of_the_wrong_length_is_refused():
    with pytest.raises(ValueError, match="expected 2 cells"):
        Page("Plain").table(["a", "b"], [["1"]])


@pytest.mark.parametrize(
    ("method", "ending"), [("image", ".mp4"), ("video", ".png"), ("image", ".exe")]
)
def test_a_file_of_the_wrong_kind_is_refused(method, ending, tmp_path):
    with pytest.raises(ValueError, match=f"expected a file of type {method}/"):
        getattr(Page("Plain"), method)(tmp_path / f"file{ending}")


@needs_chromium
@pytest.mark.parametrize("dark", [False, True])
def test_it_opens_in_a_browser_without_a_network(page, dark, tmp_path):
    with opened(page.write(tmp_path / "page.html"), dark=dark) as tab:
        assert tab.title() == f"A page {HOSTILE}"
        assert tab.locator("nav li").all_inner_texts() == ["First & foremost", "Moving"]
        assert tab.locator("td").all_inner_texts() == ["a", "1", HOSTILE, "2"]
        assert tab.locator(".chart svg.main-svg").count() >= 2
        assert tab.evaluate("[...document.images].every(i => i.complete && i.naturalWidth > 0)")
        tab.wait_for_function("document.querySelector('video').videoWidth === 32")
        assert not tab.locator("pre").is_visible()
        tab.locator("summary").click()
        assert tab.locator("pre").inner_text() == HOSTILE
        text = tab.locator(".chart .xtick text").first.evaluate("e => getComputedStyle(e).fill")
        assert text == ("rgb(228, 231, 235)" if dark else "rgb(29, 33, 39)")
