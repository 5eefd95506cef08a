"""Imported by the process that workers are forked from: each then starts with the kernel loaded."""

from unidrive_cli.warp.render import choose_toolchain, prepare

prepare(choose_toolchain())
