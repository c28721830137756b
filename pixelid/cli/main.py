"""The command line: a thin skin over the library.  Each command lives in its own file and loads when used."""

from __future__ import annotations

import importlib
import os
import signal
import sys

import click

from pixelid.cli.terminal import complain, use_utf8, warnings_as_lines
from pixelid.errors import PixelidError, did_you_mean, on_command_line
from pixelid.interruption import end_on_interrupt, ending, exit_code, sentence
from pixelid.provenance import running

# Recordings already share out the cores; BLAS threads for ten by ten matrices spin on them.  Before NumPy is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("MPLBACKEND", "Agg")  # figures go to files; no display is needed

COMMANDS = {
    "check": "A bench's recordings held against their lights, in seconds.",
    "calibrate": "From a bench of raw recordings to a checked model.",
    "models": "List the shipped circuits, or print one with units and gauge.",
    "inspect": "Health of a recording, no stimulus needed.",
    "convert": "Any readable recording to .h5, and back to text or npz.",
    "simulate": "Events of a circuit under a stimulus.",
    "fit": "Fit a circuit to recordings.",
    "compare": "Which of several models the recordings support.",
    "sensor": "Maps of thresholds and bandwidth over a whole sensor.",
    "rates": "Fit tables of event rate against the frequency of a light.",
    "latency": "Fit first-event latencies against irradiance, setting and edge.",
    "flicker": "What mains flicker alone says about the pixels.",
    "noise": "Noise events of still scenes against light: thresholds, noise, bandwidth.",
    "biases": "Laws of dead time, threshold, cutoff or latency by bias code.",
    "lowlight": "Dominant-pole analysis over radiance.",
    "design": "Which stimulus to record next, and why.",
    "stimulus": "A waveform for a generator or sound card, with a trigger channel.",
    "gap": "Which effect a model lacks: find it, name it, add it.",
    "conform": "What of the signal path a simulator or camera has, effect by effect.",
    "export": "A circuit in the parameters of another simulator.",
    "dataset": "Published raw data in the layout that reconstruct reads.",
    "reconstruct": "A sharp scene from motion-blurred events.",
    "render": "Views, videos, depth, meshes and splats of a reconstruction.",
    "view": "A pixel to play with, or a scene to fly through, in the browser.",
    "report": "A one-page report.html for any result folder.",
    "demo": "Calibrate a shipped bench session, compare with the truth.",
}


class LazyGroup(click.Group):
    """A group whose commands are modules `pixelid.cli.<name>_command`, imported only when invoked."""

    def list_commands(self, ctx):
        return list(COMMANDS)

    def get_command(self, ctx, cmd_name):
        if cmd_name not in COMMANDS:
            return None
        return importlib.import_module(f"pixelid.cli.{cmd_name}_command").command

    def format_commands(self, ctx, formatter):
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))

    def resolve_command(self, ctx, args):
        if args and args[0] not in COMMANDS:
            raise click.UsageError(
                f"no command {args[0]!r}; known: {', '.join(COMMANDS)}{did_you_mean(args[0], COMMANDS)}"
            )
        return super().resolve_command(ctx, args)


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="pixelid")
def cli() -> None:
    """Identify the circuit of an event camera's pixel from its events."""


def main(argv: list[str] | None = None) -> int:
    """Run the command line; return the exit code (0 done, 1 not trustworthy, 2 bad input or usage, 130 interrupted).

    An error that nobody foresaw is one line and exit code 1; PIXELID_DEBUG=1 adds where it happened.
    """
    use_utf8()
    with on_command_line():
        return _main(argv)


def _main(argv: list[str] | None) -> int:
    try:
        with warnings_as_lines(), running(sys.argv[1:] if argv is None else argv):
            code = cli.main(args=argv, prog_name="pixelid", standalone_mode=False)
        return code if isinstance(code, int) else 0
    except PixelidError as error:
        complain(str(error))
        return error.exit_code
    except click.exceptions.NoArgsIsHelpError as error:
        print(error.format_message(), file=sys.stderr)
        return 2
    except click.ClickException as error:
        complain(error.format_message())
        return 2
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        complain(f"{where}{error.strerror or error}")
        return 2
    except MemoryError as error:
        print(f"pixelid: not enough memory{f' ({error})' if str(error) else ''}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return _interrupted()
    except Exception as error:
        if isinstance(
            error, click.Abort
        ):  # what click makes of KeyboardInterrupt; and of EOFError, which is no such thing
            if not isinstance(error.__cause__, EOFError):
                return _interrupted()
            error = error.__cause__
        if _by_interrupt(error):
            return _interrupted()
        if os.environ.get("PIXELID_DEBUG") == "1":
            import traceback

            traceback.print_exc()
        words = " ".join(str(error).split())[:300]
        complain(
            f"unexpected {type(error).__name__}{f': {words}' if words else ''}; this is a bug, "
            "PIXELID_DEBUG=1 shows where"
        )
        return 1


def _by_interrupt(error: BaseException | None) -> bool:
    """Whether an interrupt is behind an error, as compiled code makes a SystemError of it."""
    seen: list[BaseException] = []
    while error is not None and error not in seen:
        seen.append(error)
        error = error.__cause__ or error.__context__
    return any(isinstance(one, KeyboardInterrupt) for one in seen)


def _interrupted() -> int:
    ending.set()
    print(sentence(), file=sys.stderr)
    return exit_code()


def run() -> None:
    """Console entry point."""
    try:
        end_on_interrupt(_remove_temporaries)
        code = main()
    except KeyboardInterrupt:  # before `main` could answer it, or while it did
        code = _interrupted()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # nothing is left to stop
    sys.exit(code)


def _remove_temporaries() -> None:
    """What a forced end leaves to do."""
    outputs = sys.modules.get("pixelid.outputs")  # imported by whatever writes
    if outputs is not None:
        outputs.remove_temporaries()
