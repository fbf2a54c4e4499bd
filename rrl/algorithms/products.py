"""Matrix products of a recorded update in bfloat16, all else in float32."""

from __future__ import annotations

from typing import Any

import torch
from torch.fx import Graph, Node

ATEN = torch.ops.aten
PRODUCTS = {
    ATEN.mm.default: ATEN.mm.default,
    ATEN.bmm.default: ATEN.bmm.default,
    ATEN.addmm.default: ATEN.mm.default,
    ATEN.baddbmm.default: ATEN.bmm.default,
}
"""What multiplies matrices, and what does so without a summand."""

NARROW = 64
"""A product with a side below this gains little; inputs, values and actions stay exact."""


def bfloat16_problem(device: torch.device) -> str | None:
    """Return why products in bfloat16 would be the slower ones on a device; None if not."""
    capabilities: dict[str, Any] = getattr(torch.cpu, "get_capabilities", dict)()
    knows = any(capabilities.get(name) for name in ("avx512_bf16", "amx_bf16"))
    if knows or device.type != "cpu":
        return None
    return "this processor has no instructions for bfloat16 (AVX512-BF16 or AMX)"


def multiply_in_bfloat16(graph: Graph) -> None:
    """Replace every wide product of float32 matrices by one of bfloat16 matrices.

    Factors are rounded to bfloat16, and so is the product, whose sums the processor keeps in
    float32 (as :func:`torch.autocast` has it). What is added to a product stays float32.

    Args:
        graph: Of ATen operations, each with a tensor without data in ``meta["val"]``.
    """
    for node in [node for node in graph.nodes if node.target in PRODUCTS and not node.kwargs]:
        *summand, left, right = node.args
        if _is_wide(left.meta["val"], right.meta["val"]):
            with graph.inserting_before(node):
                low = [_converted(graph, factor, torch.bfloat16) for factor in (left, right)]
                product = _call(graph, PRODUCTS[node.target], *low)
                result = _converted(graph, product, torch.float32)
                if summand:
                    result = _call(graph, ATEN.add.Tensor, result, *summand)
            node.replace_all_uses_with(result)
            graph.erase_node(node)


def _is_wide(left: torch.Tensor, right: torch.Tensor) -> bool:
    sides = *left.shape[-2:], right.shape[-1]
    return left.dtype == right.dtype == torch.float32 and min(sides) >= NARROW


def _converted(graph: Graph, node: Node, dtype: torch.dtype) -> Node:
    return _call(graph, torch.ops.prims.convert_element_type.default, node, dtype)


def _call(graph: Graph, target: Any, *args: Any) -> Node:
    node = graph.call_function(target, args)
    node.meta["val"] = target(*(a.meta["val"] if isinstance(a, Node) else a for a in args))
    return node
