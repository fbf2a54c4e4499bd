"""A Markdown page has the blocks in order, and no cell ends its table."""

from rrl.trainers.report.markdown import MarkdownPage


def test_blocks_stand_in_order_and_cells_end_no_row(tmp_path):
    page = MarkdownPage("Title")
    page.section("One")
    page.text("First.")
    page.table(["a", "b"], [["x | y", "two\nlines"], ["1", "2"]])
    page.image("figures/one.png", "A figure")
    assert page.write(tmp_path / "page.md").read_text().split("\n\n") == [
        "# Title",
        "## One",
        "First.",
        "| a | b |\n| --- | --- |\n| x \\| y | two lines |\n| 1 | 2 |",
        "![A figure](figures/one.png)\n",
    ]
