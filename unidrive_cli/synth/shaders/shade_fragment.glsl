// One pixel. Samples that see the same triangle are shaded once, in their middle.

uniform mat3 ray_from_window;  // of length 1 along the optical axis
uniform sampler2D triangles;   // vertex indices of three corners, index into `bodies`
uniform sampler2D corners;     // place, layer + gloss / 2; normal, u; albedo, v
uniform sampler2D bodies;      // rows of the turn from the global frame into the mesh's, and the camera's place in it
uniform float means[LAYER_COUNT];
uniform float varies[LAYER_COUNT];
uniform sampler2DShadow shadows;
uniform mat3 sun_axes;         // rows: right and up in the shadow maps, towards the sun
uniform vec4 cascades[3];      // scale and offset (x, y) from metres to -1..1, and the size of a texel in metres
uniform vec4 squares[3];       // the map's place in the atlas: centre (x, y) and half its side (x, y)
uniform vec2 sun_depth;        // scale and offset from metres towards the sun to depth

out vec4 result;

float lit_by_sun(vec3 q, vec3 own_normal, float bias) {
    vec3 at = sun_axes * q;
    int which = 2;
    for (int i = 2; i >= 0; i--) {
        vec2 inside = at.xy * cascades[i].x + cascades[i].yz;
        if (max(abs(inside.x), abs(inside.y)) < 0.995) which = i;
    }
    float cosine = dot(own_normal, to_sun);
    float sine = sqrt(max(1.0 - cosine * cosine, 0.0));
    float lift = bias * (2.2 * cascades[which].w * sine + 0.003);
    at += sun_axes * (own_normal * (cosine < 0.0 ? -lift : lift));
    vec2 place = at.xy * cascades[which].x + cascades[which].yz;
    if (max(abs(place.x), abs(place.y)) > 0.999) return 1.0;
    vec2 spot = squares[which].xy + place * squares[which].zw;
    return textureLod(shadows, vec3(spot, at.z * sun_depth.x + sun_depth.y), 0.0);
}

vec3 sky_seen() {
    vec3 towards = normalize(ray_from_window * vec3(gl_FragCoord.xy, 1.0));
    vec2 place = cloud_place(towards);
    vec2 along = dFdx(place) * side;
    vec2 across = dFdy(place) * side;
    float level = level_of_detail(abs(along.x * across.y - along.y * across.x), 1.0);
    float density = texel(place, float(CLOUD_LAYER), level).g;
    return exposed(sky(towards, density));
}

vec2 offset_of(int sample_index) {
    return (vec2(sample_index % GRID, sample_index / GRID) + 0.5) / float(GRID) - 0.5;
}

// What some samples of a pixel see of a triangle: the texture at each of them, all else in their `middle`.
vec3 surface_seen(int triangle, int samples, vec2 middle) {
    vec4 known = texelFetch(triangles, ivec2(triangle % ROW, triangle / ROW), 0);
    int body = int(known.w);
    vec4 rows[3];
    vec4 corner[9];
    for (int i = 0; i < 3; i++) {
        rows[i] = texelFetch(bodies, ivec2(i, body), 0);
        int vertex = int(known[i]);
        ivec2 at = ivec2(vertex % ROW * 3, vertex / ROW);
        for (int j = 0; j < 3; j++) corner[3 * i + j] = texelFetch(corners, at + ivec2(j, 0), 0);
    }
    mat3 mesh_from_global = transpose(mat3(rows[0].xyz, rows[1].xyz, rows[2].xyz));
    vec3 ray = ray_from_window * vec3(gl_FragCoord.xy + middle, 1.0);
    vec3 local = mesh_from_global * ray;

    vec3 first = corner[3].xyz - corner[0].xyz;
    vec3 second = corner[6].xyz - corner[0].xyz;
    vec3 from_corner = vec3(rows[0].w, rows[1].w, rows[2].w) - corner[0].xyz;
    vec3 own = cross(first, second);
    vec3 moment = cross(from_corner, local);
    float against = -dot(local, own);
    float scale = 1.0 / (against == 0.0 ? 1e-30 : against);
    float depth_m = clamp(dot(from_corner, own) * scale, 0.0, FAR_M);
    vec2 shares = clamp(vec2(dot(second, moment), -dot(first, moment)) * scale, 0.0, 1.0);
    vec3 weights = vec3(1.0 - shares.x - shares.y, shares);

    float length_per_depth = length(ray);
    vec3 towards = ray / length_per_depth;
    float distance_m = depth_m * length_per_depth;
    float area = max(length(own), 1e-20);
    vec3 own_normal = (own / area) * mesh_from_global;
    float facing = dot(own_normal, towards);
    vec3 normal = (weights.x * corner[1].xyz + weights.y * corner[4].xyz + weights.z * corner[7].xyz) * mesh_from_global;
    vec3 seen_normal = normalize(facing > 0.0 ? -normal : normal);
    vec3 albedo = weights.x * corner[2].xyz + weights.y * corner[5].xyz + weights.z * corner[8].xyz;
    vec2 uv = vec2(corner[1].w, corner[2].w);
    vec2 first_uv = vec2(corner[4].w, corner[5].w) - uv;
    vec2 second_uv = vec2(corner[7].w, corner[8].w) - uv;
    uv += shares.x * first_uv + shares.y * second_uv;
    float layer = floor(corner[6].w);
    float gloss = 2.0 * (corner[6].w - layer);

    mat2 uv_along;
    for (int i = 0; i < 2; i++) {
        vec3 step = mesh_from_global * ray_from_window[i];
        vec3 turned = cross(from_corner, step);
        vec2 moved = vec2(dot(second, turned), -dot(first, turned)) + shares * dot(step, own);
        uv_along[i] = scale * (moved.x * first_uv + moved.y * second_uv);
    }
    float texels = abs(determinant(uv_along)) * side * side / float(GRID * GRID);
    float level = level_of_detail(texels, abs(facing));
    vec4 looks = vec4(0.0);
    for (int i = 0; i < GRID * GRID; i++) {
        float taken = (samples & (1 << i)) != 0 ? 1.0 : 0.0;
        looks += vec4(texel(uv + uv_along * (offset_of(i) - middle), layer, level), 1.0) * taken;
    }
    vec3 base = albedo * looks.rgb / looks.a;
    int index = int(layer);
#if VARIED
    float look = texel(varied_place(uv), layer, level + log2(VARIED_SCALE)).g;
    base *= 1.0 + varies[index] * (look / means[index] - 1.0);
#endif
    float direct = sunlight(seen_normal, index == LEAF_LAYER);
    float lit = lit_by_sun(depth_m * ray, own_normal, body == 0 ? 0.0 : 1.0);  // the ground casts no shadow
    return exposed(haze(shade(base, seen_normal, towards, gloss, direct, lit), distance_m));
}

void main() {
    const int count = GRID * GRID;
    float seen[count];
    for (int i = 0; i < count; i++) seen[i] = seen_by(i);
    vec3 sum = vec3(0.0);
    float open = 0.0;
    int left = 0;
    for (int i = 0; i < count; i++) {
        if (seen[i] == 0.0) open += 1.0;
        else left |= 1 << i;
    }
#if SKY
    sum += open * sky_seen();
#endif
#if SURFACE
    do {
        float now = 0.0;
        for (int i = 0; i < count; i++) if ((left & (1 << i)) != 0) now = seen[i];
        int samples = 0;
        vec3 total = vec3(0.0);
        for (int i = 0; i < count; i++)
            if (seen[i] == now) {
                samples |= 1 << i;
                total += vec3(offset_of(i), 1.0);
            }
        left &= ~samples;
        sum += total.z * surface_seen((int(now) - 1) / 4, samples, total.xy / total.z);
    } while (left != 0);
#endif
    vec3 value = clamp(sum / float(count), 0.0, 1.0);
    vec3 curve = mix(12.92 * value, 1.055 * pow(value, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, value));
    result = vec4(curve.bgr, 1.0);
}
