uniform sampler2D roots;
uniform ivec2 start;
uniform int grid;
out vec4 result;

void main() {
    ivec2 first = (ivec2(gl_FragCoord.xy) - start) * grid;
    vec3 sum = vec3(0.0);
    for (int row = 0; row < grid; row++)
        for (int column = 0; column < grid; column++) {
            vec3 root = texelFetch(roots, first + ivec2(column, row), 0).rgb;
            sum += root * root;
        }
    vec3 value = clamp(sum / float(grid * grid), 0.0, 1.0);
    vec3 curve = mix(12.92 * value, 1.055 * pow(value, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, value));
    result = vec4(curve.bgr, 1.0);
}
