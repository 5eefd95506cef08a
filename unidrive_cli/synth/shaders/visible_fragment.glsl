uniform float first;
out float result;

void main() {
    result = first + 4.0 * float(gl_PrimitiveID);
}
