"""What the training scripts share: a LightningCLI that writes the weights at the end, and says
early if it cannot.
"""

from __future__ import annotations

from pathlib import Path

from pytorch_lightning.cli import LightningArgumentParser, LightningCLI


class TrainingCli(LightningCLI):
    """LightningCLI with the flag ``--weights``; its model has ``save(file)``."""

    def add_arguments_to_parser(self, parser: LightningArgumentParser) -> None:
        """Add the flag."""
        parser.add_argument(
            "--weights",
            type=str | None,
            default=None,
            help="file for the weights after the last step",
        )

    def before_instantiate_classes(self) -> None:
        """Refuse a file that could not be written after the training."""
        file = self.config[self.subcommand].weights
        if file is not None and not Path(file).parent.is_dir():
            raise SystemExit(f"weights: there is no folder {Path(file).parent}")

    def after_fit(self) -> None:
        """Write the weights."""
        file = self.config["fit"]["weights"]
        if file is not None and self.trainer.is_global_zero:
            self.model.save(file)
