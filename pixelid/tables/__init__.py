"""Observation models of tables: what a table of rates, phases, latencies or noise says about the pixel.

One way in (`reading.py`), one fitter for values (`fit.py`) and one for counts (`counts.py`), one judgement and one
writer (`result.py`).  A kind of table is a folder with a `TableModel` (`model.py`), its words and its figures:
`rates/` (event rates against the frequency of a blinking light), `flicker/` (phases under mains light),
`noise/` (events of the circuit's own noise against light).
"""
