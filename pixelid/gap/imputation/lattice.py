"""All true times of a pixel drawn at once, compiled: forward filtering, backward sampling over a lattice of orders.

A pixel's events are a Markov chain: given the time and polarity of one, the circuit says with what chance the next
crosses either threshold in any short span (a cell; `chances.py`).  What is recorded of each is its polarity and a
stamp, but not the order: of two stamps of different polarity closer than a readout blurs, either may have come first.
So the states of the chain are

    (i, j, q, cell): i ON and j OFF events have come, the last of polarity q, in this cell of time

and the chance of all stamps so far, given that state, follows from those with one event less (Baum et al. 1970, Ann.
Math. Stat. 41, 164; Rauch's smoother for normals).  Backward from the end, a path is drawn from what the forward pass
left (Carter & Kohn 1994, Biometrika 81, 541).  Stamps of one polarity stay in the order that they are given in.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from pixelid.gap.imputation.chances import add_chances

LEAST = 1e-4  # of the largest chance of a state's cells: less is dropped
LEAST_ORDER = 1e-7  # of the likeliest order of as many events: a less likely one, what is to come counted, is dropped
MOST_CELLS = 48  # of a state: more are merged, by twos.  128 change the log-likelihood of 11,000 stamps by 10 nats.
MOST_OFFERED = 4096  # cells under one stamp
SHARE_OF_NOISE = 0.5  # of a threshold's noise that the change may move by within a cell
MOST_STRIDE = 64


@njit(cache=True, error_model="numpy")
def _stride(light, first, last, sd):
    """Width of cells, a power of two, in which the change moves by a small share of the thresholds' noise."""
    steepest = 0.0
    for k in range(first, last):
        steepest = max(steepest, abs(light.output[k + 1] - light.output[k]))
    stride = 1
    while stride < MOST_STRIDE and 2 * stride * steepest < SHARE_OF_NOISE * sd and (last - first) > 64 * stride:
        stride *= 2
    while (last - first) // stride + 1 > MOST_OFFERED:
        stride *= 2
    return stride


@njit(cache=True, error_model="numpy")
def _kept(cells, first, stride):
    """(begin, end, times) of the cells that matter, and by how many twos they are to be merged."""
    largest = 0.0
    for value in cells:
        largest = max(largest, value)
    begin, end = 0, len(cells)
    while begin < end and cells[begin] <= LEAST * largest:
        begin += 1
    while end > begin and cells[end - 1] <= LEAST * largest:
        end -= 1
    merged = 1
    while (end - begin + merged - 1) // merged > MOST_CELLS:
        merged *= 2
    return begin, end, merged


@njit(cache=True, error_model="numpy")
def _window(light, centre, reach):
    """(first, last) cells within reach of a stamp; the one that holds it at least."""
    first = math.ceil((centre - reach - light.begin) / light.step)
    last = max(math.floor((centre + reach - light.begin) / light.step), first)
    return max(first, 1), min(last, len(light.output) - 1)


@njit(cache=True, error_model="numpy")
def _share(end, stride, low, high):
    """Of a cell `stride` wide that ends at `end`, what lies in a window of the cells low … high."""
    return max(min(end, high) - max(end - stride, low - 1), 0) / stride


@njit(cache=True, nogil=True, error_model="numpy")
def draw_path(
    light, at, stamps_on, stamps_off, sd, reach_on, reach_off, in_order, background_hz, uniform, on_times, off_times
):  # fmt: skip
    """Draw all true times of one pixel in one recording, s; fills `on_times`, `off_times`.

    light, at: `Light`, `Thresholds`
    stamps_on, stamps_off: (I,), (J,) s, each in the order in which their events come
    sd: of the stamps about the times, s; infinite: only `reach` counts
    reach_on, reach_off: (I,), (J,) s, by which each stamp can be off
    in_order: whether events came in the order of their stamps, whatever their polarity
    background_hz: of events without a cause
    uniform: (2 (I + J),) random numbers

    Returns the log-likelihood of the stamps, first ones given; −inf where no path leads to the end: nothing is drawn.
    """
    n_on, n_off = len(stamps_on), len(stamps_off)
    total = n_on + n_off
    capacity = 2048 + total * 2 * MOST_CELLS
    weights = np.empty(capacity)
    most_nodes = 16 * total + 64
    node = np.empty((most_nodes, 7), np.int64)  # i, j, q, first cell, stride, cells, offset
    layer = np.zeros(total + 1, np.int64)  # where the nodes with k + 1 events begin
    used, nodes, log_z = 0, 0, 0.0
    sd_least = min(at.sd_on, at.sd_off)
    # first events, of either polarity
    for q in (1, 0):
        if (n_on if q == 1 else n_off) == 0:
            continue
        stamp, reach = (stamps_on[0], reach_on[0]) if q == 1 else (stamps_off[0], reach_off[0])
        other = n_off if q == 1 else n_on
        if other > 0 and stamp - reach > (stamps_off[0] + reach_off[0] if q == 1 else stamps_on[0] + reach_on[0]):
            continue
        if other > 0 and in_order and stamp > (stamps_off[0] if q == 1 else stamps_on[0]):
            continue
        first, last = _window(light, stamp, reach)
        if last < first:
            continue
        stride = _stride(light, first, last, sd_least)
        cells = np.ones((last - first + stride - 1) // stride + 1)
        for c in range(len(cells)):
            cells[c] = _share(first + c * stride, stride, first, last)
        used, nodes, weights, node = _add(
            light, cells, first, stride, stamp, sd, (1, 0, 1) if q == 1 else (0, 1, 0), weights, used, node, nodes
        )
    for k in range(total):
        begin, end = layer[k], nodes
        best = 0.0
        for a in range(begin, end):
            best += _sum(weights, node, a)
        if not best > 0.0:
            return -np.inf
        log_z += math.log(best)
        for a in range(begin, end):
            offset, n = node[a, 6], node[a, 5]
            for c in range(n):
                weights[offset + c] /= best
        if k + 1 == total:
            layer[k + 1] = end
            break
        layer[k + 1] = end
        # each pair (i, j) of this layer leads to an ON event and to an OFF event
        low, high = max(0, k + 1 - n_off), min(n_on, k + 1)
        promise = np.zeros(high - low + 1)
        for a in range(begin, end):
            promise[node[a, 0] - low] += _promise(light, weights, node, a, stamps_on, stamps_off, sd)
        for i in range(low, high + 1):
            j = k + 1 - i
            if not promise[i - low] > LEAST_ORDER * promise.max():
                continue
            used, nodes, weights, node = _advance(
                light,
                at,
                stamps_on,
                stamps_off,
                sd,
                reach_on,
                reach_off,
                in_order,
                background_hz,
                i,
                j,
                begin,
                end,
                weights,
                used,
                node,
                nodes,
                sd_least,
            )
        if nodes == end:
            return -np.inf
    _backward(light, at, background_hz, weights, node, layer, total, nodes, uniform, on_times, off_times)
    return log_z


@njit(cache=True, error_model="numpy")
def _sum(weights, node, a):
    total = 0.0
    for c in range(node[a, 6], node[a, 6] + node[a, 5]):
        total += weights[c]
    return total


@njit(cache=True, error_model="numpy")
def _promise(light, weights, node, a, stamps_on, stamps_off, sd):
    """Chance of a state, times the most that the next stamps can add: they belong to times later than its own."""
    mass, mean = 0.0, 0.0
    for c in range(node[a, 5]):
        mass += weights[node[a, 6] + c]
        mean += weights[node[a, 6] + c] * _middle(light, node, a, c)
    if not mass > 0.0 or not math.isfinite(sd):
        return mass
    mean /= mass
    late_on = max(0.0, mean - stamps_on[node[a, 0]]) / sd if node[a, 0] < len(stamps_on) else 0.0
    late_off = max(0.0, mean - stamps_off[node[a, 1]]) / sd if node[a, 1] < len(stamps_off) else 0.0
    return mass * math.exp(-0.5 * (late_on**2 + late_off**2))


@njit(cache=True, error_model="numpy")
def _middle(light, node, a, c):
    """Time of the middle of a state's cell c, s."""
    return light.begin + light.step * (node[a, 3] + (c - 0.5) * node[a, 4])


@njit(cache=True, error_model="numpy")
def _add(light, cells, first, stride, stamp, sd, state, weights, used, node, nodes):
    """The lattice with one state more: its cells weighed by the stamp, cut and merged."""
    if math.isfinite(sd):
        for c in range(len(cells)):
            away = (stamp - light.begin - light.step * (first + (c - 0.5) * stride)) / sd
            cells[c] *= math.exp(-0.5 * away * away)
    begin, end, merged = _kept(cells, first, stride)
    n = (end - begin + merged - 1) // merged
    if n <= 0:
        return used, nodes, weights, node
    if used + n > len(weights):
        more = np.empty(2 * len(weights) + n)
        more[:used] = weights[:used]
        weights = more
    if nodes == len(node):
        longer = np.empty((2 * len(node), 7), np.int64)
        longer[:nodes] = node[:nodes]
        node = longer
    for c in range(n):
        value = 0.0
        for b in range(begin + c * merged, min(begin + (c + 1) * merged, end)):
            value += cells[b]
        weights[used + c] = value
    node[nodes, 0], node[nodes, 1], node[nodes, 2] = state
    node[nodes, 3], node[nodes, 4] = first + (begin + merged - 1) * stride, stride * merged
    node[nodes, 5], node[nodes, 6] = n, used
    return used + n, nodes + 1, weights, node


@njit(cache=True, error_model="numpy")
def _advance(
    light, at, stamps_on, stamps_off, sd, reach_on, reach_off, in_order, background_hz, i, j, begin, end, weights, used,
    node, nodes, sd_least,
):  # fmt: skip
    """The lattice with the states that follow those with i ON and j OFF events."""
    want_on, want_off = i < len(stamps_on), j < len(stamps_off)
    # an event cannot come next whose stamp is later than the other polarity's next can be
    if want_on and want_off:
        if stamps_on[i] - reach_on[i] > stamps_off[j] + reach_off[j]:
            want_on = False
        elif stamps_off[j] - reach_off[j] > stamps_on[i] + reach_on[i]:
            want_off = False
        elif in_order:
            want_on = stamps_on[i] <= stamps_off[j]
            want_off = not want_on
    first, last = len(light.output), 0
    if want_on:
        low, high = _window(light, stamps_on[i], reach_on[i])
        first, last = min(first, low), max(last, high)
    if want_off:
        low, high = _window(light, stamps_off[j], reach_off[j])
        first, last = min(first, low), max(last, high)
    if last < first:
        return used, nodes, weights, node
    stride = _stride(light, first, last, sd_least)
    n = (last - first + stride - 1) // stride + 1
    last = min(first + (n - 1) * stride, len(light.output) - 1)
    cells_on, cells_off = np.zeros(n if want_on else 0), np.zeros(n if want_off else 0)
    later = np.zeros(n + 1)
    for a in range(begin, end):
        if node[a, 0] != i:
            continue
        before = 1.0 if node[a, 2] == 1 else -1.0
        for c in range(node[a, 5]):
            weight = weights[node[a, 6] + c]
            if weight <= 0.0:
                continue
            when = _middle(light, node, a, c)
            cell = math.floor((when - light.begin) / light.step) + 1
            later[min(max((cell - first + stride - 1) // stride + 1, 0), n)] += weight
            add_chances(light, at, when, before, first, stride, last, cells_on, cells_off, weight)
    chance = background_hz * light.step * stride
    for q in (1, 0):
        if not (want_on if q == 1 else want_off):
            continue
        cells, stamp, reach = (
            (cells_on, stamps_on[i], reach_on[i]) if q == 1 else (cells_off, stamps_off[j], reach_off[j])
        )
        low, high = _window(light, stamp, reach)
        come = 0.0
        for c in range(n):
            come += later[c]
            here = first + c * stride
            cells[c] = (cells[c] + chance * come) * _share(here, stride, low, high)
        state = (i + 1, j, 1) if q == 1 else (i, j + 1, 0)
        used, nodes, weights, node = _add(light, cells, first, stride, stamp, sd, state, weights, used, node, nodes)
    return used, nodes, weights, node


@njit(cache=True, error_model="numpy")
def _backward(light, at, background_hz, weights, node, layer, total, nodes, uniform, on_times, off_times):
    """Draw a path from the last layer to the first."""
    a, c = _pick(weights, node, layer[total - 1], nodes, uniform[0])
    nothing, latest = np.empty(0), np.inf
    for k in range(total - 1, -1, -1):
        i, j, q, stride = node[a, 0], node[a, 1], node[a, 2], node[a, 4]
        edge = node[a, 3] + c * stride
        # cells let an event by up to a cell's width into the dead time before the next one
        when = min(light.begin + light.step * (edge - uniform[2 * k + 1] * stride), latest)
        latest = when - light.dead
        if q == 1:
            on_times[i - 1] = when
        else:
            off_times[j - 1] = when
        if k == 0:
            return
        i, j = (i - 1, j) if q == 1 else (i, j - 1)
        begin, end = layer[k - 1], layer[k]
        count = 0
        for b in range(begin, end):
            if node[b, 0] == i and node[b, 1] == j:
                count += node[b, 5]
        chances, of, which = np.zeros(count), np.empty(count, np.int64), np.empty(count, np.int64)
        cell, at_least, s = np.zeros(1), background_hz * light.step * stride, 0
        for b in range(begin, end):
            if node[b, 0] != i or node[b, 1] != j:
                continue
            before = 1.0 if node[b, 2] == 1 else -1.0
            for e in range(node[b, 5]):
                from_ = _middle(light, node, b, e)
                cell[0] = at_least if from_ < light.begin + light.step * edge else 0.0
                if q == 1:
                    add_chances(light, at, from_, before, edge, stride, edge, cell, nothing, 1.0)
                else:
                    add_chances(light, at, from_, before, edge, stride, edge, nothing, cell, 1.0)
                chances[s] = weights[node[b, 6] + e] * cell[0]
                of[s], which[s] = b, e
                s += 1
        sum_ = chances.sum()
        target, s = uniform[2 * k] * sum_, 0
        gone = chances[0]
        while gone < target and s + 1 < count:
            s += 1
            gone += chances[s]
        a, c = of[s], which[s]


@njit(cache=True, error_model="numpy")
def _pick(weights, node, begin, end, uniform):
    """A state and a cell of a layer by their chances."""
    total = 0.0
    for a in range(begin, end):
        total += _sum(weights, node, a)
    target, gone = uniform * total, 0.0
    for a in range(begin, end):
        for c in range(node[a, 5]):
            gone += weights[node[a, 6] + c]
            if gone >= target and weights[node[a, 6] + c] > 0.0:
                return a, c
    return end - 1, node[end - 1, 5] - 1
