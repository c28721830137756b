"""Figures of a reconstruction: views side by side with their errors, and how training went."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pixelid.nerf.reconstruct import Reconstruction

SHOWN = 5


def write_figures(result: Reconstruction, folder: Path) -> None:
    """Write views.png and training.png into an existing folder."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    truth, predicted = result.truth.images, result.scores.images
    which = np.unique(np.linspace(0, len(truth) - 1, min(SHOWN, len(truth))).astype(int))
    figure, axes = plt.subplots(3, len(which), figsize=(2.2 * len(which), 6.6), layout="constrained", squeeze=False)
    peak = result.truth.peak
    for column, k in enumerate(which):
        error = np.abs(predicted[k] - np.clip(truth[k], 0, peak)).mean(axis=-1)
        for row, image in enumerate((truth[k], predicted[k])):
            shown = np.clip(image / peak, 0, 1)
            axes[row, column].imshow(shown if shown.shape[-1] == 3 else shown[..., 0], cmap="gray", vmin=0, vmax=1)
        error_map = axes[2, column].imshow(error, cmap="magma", vmin=0, vmax=0.3 * peak)
        axes[1, column].set_xlabel(f"{result.scores.psnr[k]:.1f} dB")
        axes[0, column].set_title(result.truth.names[k], fontsize=8)
    for row, name in enumerate(("reference", "reconstruction", "absolute error")):
        axes[row, 0].set_ylabel(name)
    for axis in axes.flat:
        axis.set_xticks([])
        axis.set_yticks([])
    figure.colorbar(error_map, ax=axes[2].tolist(), shrink=0.8)
    figure.savefig(folder / "views.png", dpi=100)
    plt.close(figure)
    if result.state.history:
        _training(result, folder / "training.png", plt)


def _training(result: Reconstruction, path: Path, plt) -> None:
    history = result.state.history
    steps = [entry["iteration"] for entry in history]
    figure, (left, right) = plt.subplots(1, 2, figsize=(8, 3), layout="constrained")
    for name in ("diff", "chain", "tv"):
        left.plot(steps, [entry[name] for entry in history], label=f"ℓ_{name}")
    left.set_yscale("log")
    left.set_xlabel("step")
    left.legend()
    right.plot(steps, [entry["running_psnr"] for entry in history], color="black")
    right.set_xlabel("step")
    right.set_ylabel("PSNR of a validation view [dB]")
    figure.savefig(path, dpi=100)
    plt.close(figure)
