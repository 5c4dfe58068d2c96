// What viewer.js uses of three.js: scripts/vendor-three packs it into three.min.js.
export {
  BufferAttribute, BufferGeometry, DataTexture, DoubleSide, GLSL3, LinearFilter, LineBasicMaterial, LineSegments,
  Mesh, NearestFilter, PerspectiveCamera, Raycaster, Scene, ShaderMaterial, Vector2, Vector3,
  WebGLRenderer,
} from "three";
export { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
