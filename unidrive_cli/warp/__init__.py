"""From geometry to pixels: remap tables, blending, coverage masks, pictures in and out."""
