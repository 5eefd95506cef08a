"""What the datasets say in words, for the merged one: TRAINING.md, and the samples that were left out."""

from __future__ import annotations

from collections.abc import Iterator

from unidrive_cli.convert.sweeps import SWEEP
from unidrive_cli.errors import DatasetError
from unidrive_cli.merge.plan import MergePlan, Part
from unidrive_cli.tables.destination import FAILED, TRAINING


def training_text(plan: MergePlan) -> str:
    """What all datasets' TRAINING.md say; then, for each of them, what it alone says."""
    texts = [_text(part, TRAINING).splitlines() for part in plan.parts]
    common = [line for line in texts[0] if all(line in text for text in texts)]
    lines = [
        *common,
        *([] if common[-1:] == [""] else [""]),
        f"Merged of {len(plan.parts)} datasets by `unidrive merge`; open it as version `{plan.version}`.",
    ]
    for position, (part, text) in enumerate(zip(plan.parts, texts, strict=True), 1):
        own = [line for line in text if line not in common]
        if own:
            scenes = "1 scene" if part.scenes == 1 else f"{part.scenes} scenes"
            lines += ["", f"Of dataset {position} ({scenes}) alone:", "", *own]
    if plan.splits:
        lines += ["", f"`splits.json` names the splits: {', '.join(plan.splits)}."]
    return "\n".join(lines) + "\n"


def failures_of(plan: MergePlan) -> Iterator[tuple[str, str, str]]:
    """Sample token, scene and reason of what was left out of the datasets."""
    for part in plan.parts:
        for line in _text(part, FAILED).splitlines():
            token, _, rest = line.partition("\t")
            scene, _, reason = rest.partition("\t")
            if not token.startswith(SWEEP):
                token = part.renaming.token("sample", token)
            yield token, part.renaming.scenes.get(scene, scene), reason


def _text(part: Part, name: str) -> str:
    path = part.source.root / name
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except FileNotFoundError:
        return ""
    except OSError as error:
        raise DatasetError(f"cannot be read: {error.strerror}.", where=str(path)) from error
