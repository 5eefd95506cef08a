// Depths sort the pixels by what shades them, so that each shading program runs where it is needed.

int shading_of(float seen) {
    return seen == 0.0 ? SKY_ONLY : (int(seen) - 1) & 3;
}

void main() {
    int shading = shading_of(seen_by(0));
    for (int i = 1; i < GRID * GRID; i++)
        if (shading_of(seen_by(i)) != shading) shading = MIXED;
    gl_FragDepth = 0.5 + float(shading) / 16.0;
}
