"""A page in headless Chromium, and questions about how it looks."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from cfgplan_runtime.page.server import PageServer
from operated_world import PATIENCE_S, eventually

CHROMIUM = Path("/usr/bin/chromium")
SHIFTS = """
window.shifts = [];
new PerformanceObserver((list) => {
  for (const entry of list.getEntries()) for (const { node } of entry.sources)
    window.shifts.push((node?.id || node?.className || node?.textContent || "?") + " " + entry.value);
}).observe({ type: "layout-shift", buffered: true });
"""
MISPLACED = """() => {
  const seen = [], wrong = [];
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const node = walker.currentNode, parent = node.parentElement;
    if (!node.data.trim() || parent.closest("title, option, script, textarea") || !parent.checkVisibility()) continue;
    const range = document.createRange();
    range.selectNodeContents(node);
    for (const line of range.getClientRects()) {
      const rect = { left: line.left, top: line.top, right: line.right, bottom: line.bottom };
      for (let box = parent; box && box !== document.body; box = box.parentElement) {
        if (getComputedStyle(box).overflow === "visible" || box instanceof SVGElement) continue;
        const clip = box.getBoundingClientRect();
        rect.left = Math.max(rect.left, clip.left); rect.right = Math.min(rect.right, clip.right);
        rect.top = Math.max(rect.top, clip.top); rect.bottom = Math.min(rect.bottom, clip.bottom);
      }
      if (rect.right - rect.left < 1 || rect.bottom - rect.top < 1) continue;
      if (rect.left < 0 || rect.right > innerWidth + 0.5) wrong.push(`outside: ${node.data}`);
      seen.push({ node, ...rect });
    }
  }
  seen.forEach((one, at) => seen.slice(at + 1).forEach((other) => {
    const width = Math.min(one.right, other.right) - Math.max(one.left, other.left);
    const height = Math.min(one.bottom, other.bottom) - Math.max(one.top, other.top);
    if (one.node !== other.node && width > 1.5 && height > 2.5) wrong.push(`${one.node.data} | ${other.node.data}`);
  }));
  const wide = document.documentElement.scrollWidth;
  if (wide > innerWidth) wrong.push(`the page is ${wide} px wide`);
  return [seen.length, wrong];
}"""
"""Returns the number of lines of text that can be seen, and those that lie on others or outside of the window."""


@contextmanager
def browser(page: PageServer, **context: Any) -> Iterator[tuple[Any, list[str]]]:
    """A tab with the page, and the complaints of its console."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed (extra dev)")
    if not CHROMIUM.exists():
        pytest.skip("there is no Chromium at /usr/bin/chromium")
    quiet = ["--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-component-update"]
    with playwright.sync_playwright() as started:
        args, patience_ms = [*quiet, "--disable-sync"], PATIENCE_S * 1000
        chromium = started.chromium.launch(executable_path=str(CHROMIUM), args=args, timeout=patience_ms)
        tab = chromium.new_context(**context).new_page()
        tab.set_default_timeout(patience_ms)
        tab.add_init_script(SHIFTS)
        wrong: list[str] = []
        tab.on("console", lambda said: wrong.append(said.text) if said.type in ("error", "warning") else None)
        tab.on("pageerror", lambda error: wrong.append(str(error)))
        inside = (page.url[:16], "data:")
        tab.on("request", lambda one: None if one.url.startswith(inside) else wrong.append(one.url))
        tab.goto(page.url)
        tab.wait_for_selector("#picture svg")
        yield tab, wrong
        chromium.close()


def await_so(tab: Any, expression: str) -> None:
    """Wait until an expression is true in the page, whose policy forbids to evaluate texts as Playwright would."""
    eventually(lambda: tab.evaluate(expression))


def await_frames(tab: Any, count: int = 3) -> None:
    """Wait until the page has shown so many more states: the last of them was asked for after this call."""
    wanted = int(tab.get_attribute("body", "data-frames")) + count
    eventually(lambda: int(tab.get_attribute("body", "data-frames")) >= wanted)


def assert_legible(tab: Any) -> None:
    """No text lies on another one or outside of the window."""
    count, wrong = tab.evaluate(MISPLACED)
    assert count > 20, "the page is nearly empty"
    assert not wrong, "\n".join(wrong[:20])
