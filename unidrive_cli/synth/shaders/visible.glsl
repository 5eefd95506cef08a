// What each sample of a pixel sees: 0 the sky, else 4 * triangle + kind + 1, with the kinds of gl_renderer.py.

uniform sampler2D visible;
uniform ivec2 start;

float seen_by(int sample_index) {
    ivec2 first = (ivec2(gl_FragCoord.xy) - start) * GRID;
    return texelFetch(visible, first + ivec2(sample_index % GRID, sample_index / GRID), 0).r;
}
