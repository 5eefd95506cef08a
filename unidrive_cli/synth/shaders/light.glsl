// The formulas of light.py, in the same order and with its constants; a change there is a change here.
// GLOSSY and VARIED are switched off where no triangle needs them.

uniform vec3 to_sun;
uniform vec3 sun;
uniform vec3 zenith;
uniform vec3 horizon;
uniform vec3 sky_mean;
uniform vec3 bounce;
uniform vec3 cloud_bright;
uniform vec3 cloud_dark;
uniform float cloud;
uniform float haze_m;
uniform sampler2DArray tiles;
uniform float side;

vec3 texel(vec2 uv, float layer, float level) {
    vec3 root = textureLod(tiles, vec3(uv, layer), level).rgb;
    return root * root;
}

vec3 sky_gradient(vec3 towards) {
    float below = 1.0 - max(towards.z, 0.0);
    below *= below;
    below *= below;
    return mix(zenith, horizon, below);
}

vec3 sky(vec3 towards, float density) {
    vec3 colour = sky_gradient(towards);
    float along = max(dot(towards, to_sun), 0.0);
    float wide = pow(along, GLOW_WIDE_POWER);
    float glow = GLOW_WIDE * wide + GLOW_NEAR * pow(along, GLOW_NEAR_POWER);
    glow += DISC * smoothstep(DISC_OUTER, DISC_INNER, along);
    colour += sun * glow;
    float threshold = 1.0 - cloud;
    float cover = smoothstep(threshold - CLOUD_SOFT, threshold + CLOUD_SOFT, density) * min(cloud * 8.0, 1.0);
    cover *= smoothstep(CLOUD_LOW, CLOUD_HIGH, towards.z);
    float thick = smoothstep(threshold, threshold + 0.6, density);
    vec3 billow = mix(cloud_bright, cloud_dark, thick) + sun * (0.25 * wide);
    return mix(colour, billow, cover);
}

vec2 cloud_place(vec3 towards) {
    return towards.xy * (CLOUD_SCALE / max(towards.z, CLOUD_LOW));
}

vec3 mirrored(vec3 towards, float lit) {
    float along = max(dot(towards, to_sun), 0.0);
    vec3 colour = sky_gradient(towards) + sun * (GLOW_WIDE * pow(along, GLOW_WIDE_POWER));
    colour = mix(bounce, colour, smoothstep(MIRROR_LOW, MIRROR_HIGH, towards.z));
    return colour + sun * (lit * GLINT * pow(along, GLINT_POWER));
}

float sunlight(vec3 normal, bool leaf) {
    float facing = dot(normal, to_sun);
    return max(facing, (leaf ? -LEAF_TRANSMISSION : 0.0) * facing);
}

vec3 shade(vec3 albedo, vec3 normal, vec3 towards, float gloss, float direct, float lit) {
    float up = 0.5 + 0.5 * normal.z;
    vec3 colour = albedo * (mix(bounce, sky_mean, up) + sun * (direct * lit));
#if GLOSSY
    if (gloss > 0.0) {
        float facing = dot(normal, towards);
        float edge = 1.0 - clamp(-facing, 0.0, 1.0);
        float square = edge * edge;
        float share = gloss + (1.0 - gloss) * min(gloss * GLOSS_EDGE, 1.0) * square * square * edge;
        colour = mix(colour, mirrored(towards - 2.0 * facing * normal, lit), share);
    }
#endif
    return colour;
}

vec3 haze(vec3 colour, float distance_m) {
    return mix(horizon, colour, exp(-distance_m / haze_m));
}

vec3 exposed(vec3 colour) {
    vec3 value = colour * EXPOSURE;
    vec3 above = max(value - SHOULDER, 0.0);
    float room = 1.0 - SHOULDER;
    return min(value, vec3(SHOULDER)) + room * (1.0 - exp(-above / room));
}

float level_of_detail(float area_texels, float facing) {
    return 0.5 * log2(max(area_texels, 1e-12)) - 0.5 * (GRAZING - 1.0) * log2(max(facing, 0.01)) + LOD_BIAS;
}

vec2 varied_place(vec2 uv) {
    return VARIED_SCALE * vec2(0.8 * uv.x - 0.6 * uv.y, 0.6 * uv.x + 0.8 * uv.y);
}
