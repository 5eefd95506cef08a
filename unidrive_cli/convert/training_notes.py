"""TRAINING.md: what a trainer must be told about the virtual rig."""

from __future__ import annotations

from unidrive_cli.convert.options import Options
from unidrive_cli.convert.plan import STANDARD_SIZE_PX, Plan, has_standard_channels, lidar_notes
from unidrive_cli.tables.layouts.base import OFFICIAL_VERSIONS


def training_notes(plan: Plan) -> str:
    """Markdown text: names, sizes, and the configuration lines that differ from nuScenes' own."""
    rig = plan.rig
    lines = [
        f"# Training on this dataset: virtual rig `{rig.name}`",
        "",
        "| channel | width | height | horizontal field of view |",
        "| --- | --- | --- | --- |",
    ]
    for camera in rig.cameras:
        lens = camera.lens
        lines.append(f"| {camera.channel} | {lens.width_px} | {lens.height_px} | {lens.hfov_deg:.2f} degrees |")
    lens = rig.cameras[0].lens
    lines += ["", f"- Number of cameras: {len(rig.cameras)}."]
    if has_standard_channels(rig):
        lines.append("- The six nuScenes channel names: trainers need no change of camera names.")
    else:
        names = ", ".join(f"'{channel}'" for channel in rig.channels)
        lines += [
            f"- mmdetection3d, BEVDet, PETR, BEVFormer: replace the list of camera types by [{names}],",
            f"  and `num_cams=6` (or `Ncams=6`) by {len(rig.cameras)}.",
            f"- LSS: `data_aug_conf['cams'] = [{names}]`, `data_aug_conf['Ncams'] = {len(rig.cameras)}`.",
        ]
    if (lens.width_px, lens.height_px) != STANDARD_SIZE_PX:
        lines += [
            f"- LSS and BEVDet: source size `H={lens.height_px}, W={lens.width_px}` (`src_size`), not 900, 1600.",
            f"- mmdetection3d's 2D boxes assume 1600x900: its converter needs ({lens.width_px}, {lens.height_px}).",
        ]
    lines += [
        "- Black pixels were seen by no source camera"
        + (", or are not common to the fleet" if plan.common else "")
        + ("." if plan.options.masks == "none" else "; `masks/` says which (non-zero = seen)."),
        *_common(plan),
        *(
            [
                f"- Pictures covered less than {100 * plan.options.min_coverage:g}% are left out: samples may lack "
                "cameras, and code that stacks all of them must be told."
            ]
            if plan.options.min_coverage and plan.options.low_coverage == "drop-picture"
            else []
        ),
        *(
            ["- Every camera has key frames and sweeps (`sweeps/`, `is_key_frame` false), as lidars have."]
            if plan.sweeps
            else []
        ),
        f"- Boxes that the virtual rig does not show are {_unseen_boxes(plan.options)}.",
        "- `image_annotations.json` holds 2D boxes of the virtual pictures.",
        f"- Open with nuscenes-devkit: `NuScenes(version='{plan.version}', dataroot=...)`.",
    ]
    if plan.version not in OFFICIAL_VERSIONS:
        lines.append(
            f"- The version folder `{plan.version}` is none of {', '.join(OFFICIAL_VERSIONS)}: the devkit's "
            "splits and most converters accept only those, with nuScenes' own scene names; give them your own split "
            "(`--output-version v1.0-trainval` names the folder so)."
        )
    lines += [f"- {note}" for note in lidar_notes(plan.dataset)]
    return "\n".join(lines) + "\n"


def _common(plan: Plan) -> list[str]:
    if plan.common is None or plan.common_masks is None:
        return [
            "- Detectors learn where the black is. For one that is to work on other cars, convert all that it "
            "learns from and is tested on with `--common-with` each of these cars (or a fleet file)."
        ]
    shares = zip(plan.rig.channels, plan.common_masks.shares, strict=True)
    names = ", ".join(sorted(rig.name for rig in plan.common.rigs))
    return [
        f"- Pictures show only what all of {names} can fill: "
        + ", ".join(f"{channel} {share:.0%}" for channel, share in shares)
        + ". Train and test on datasets with this common coverage."
    ]


def _unseen_boxes(options: Options) -> str:
    if options.unseen_boxes == "drop":
        return "left out"
    if options.visibility == "keep":
        return "kept as they were"
    return "kept with the lowest visibility: filter on it"
