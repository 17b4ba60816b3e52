//! Of the formats that are text.

use super::{Seed, fixture};

const G2O: [(&str, &str); 3] = [
    (
        "plane",
        "# two poses and a closure\nVERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1.5 -2e-1 0.5\nVERTEX_SE2 7 1 1 3.1\nFIX 0\n\
         EDGE_SE2 0 1 1.5 -0.2 0.5 10 0 0 10 0 100\nEDGE_SE2 1 7 0.1 0.2 0.3 10 1 0 10 0 100\nEDGE_SE2 0 7 1 1 3 1 0 0 1 0 1\n",
    ),
    (
        "space",
        "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nVERTEX_SE3:QUAT 1 1 2 3 0 0 0.7071 0.7071\n\
         EDGE_SE3:QUAT 0 1 1 2 3 0 0 0.7071 0.7071 1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1\n",
    ),
    ("edges", "EDGE_SE2 3 4 1 0 0 1 0 0 1 0 1\nEDGE_SE2 4 5 1 0 0 1 0 0 1 0 1\n"),
];

const TUM: [(&str, &str); 2] = [
    (
        "two",
        "# stamp x y z qx qy qz qw\n1305031102.175304 1 2 3 0 0 0 1\n1305031103.000000001 -1e3 .5 0 0 0 0.6 0.8\n",
    ),
    ("before-1970", "-1.5 0 0 0 1 0 0 0\n\n"),
];

const ODOMETRY: [(&str, &str); 3] = [
    ("csv", "stamp_ns,x_m,y_m,yaw_rad\n1000000000,0,0,0\n2000000000,1.5,-2,7.1\n"),
    ("tum", "stamp_s x y z qx qy qz qw\n1.5 1 2 3 0 0 0 1\n1.0e1 1 2 3 0 0 0.6 0.8\n"),
    ("semicolons", "stamp_ns;x_m;y_m;yaw_rad\n1;0;0;0\n"),
];

const CAMERAS: [(&str, &str); 8] = [
    (
        "ros",
        "%YAML:1.0\nimage_width: 640\nimage_height: 480\ncamera_matrix: !!opencv-matrix\n  rows: 3\n  cols: 3\n  \
         data: [438.78, 0., 305.59, 0., 437.35, 243.33, 0., 0., 1.]\ndistortion_model: plumb_bob\n\
         distortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [-0.36, 0.09, 0.0004, 0.0001, 0.]\n",
    ),
    (
        "echoed",
        "height: 480\nwidth: 640\ndistortion_model: plumb_bob\nd:\n- 0.1\n- 0.2\n- 0.0\n- 0.0\n- 0.0\n\
         k: [400.0, 0.0, 320.0, 0.0, 401.0, 240.0, 0.0, 0.0, 1.0]\n---\n",
    ),
    (
        "kalibr",
        "cam0:\n  camera_model: pinhole\n  distortion_coeffs: [0.1, 0.2, 0.3, 0.4]\n  distortion_model: equidistant\n  \
         intrinsics: [461.6, 460.3, 363.2, 248.1]\n  resolution: [640, 480]\n",
    ),
    (
        "euroc",
        "#Default\nsensor_type: camera\nresolution: [640, 480]\ncamera_model: pinhole\n\
         intrinsics: [458.654, 457.296, 367.215, 248.375] #fu\ndistortion_model: radial-tangential\n\
         distortion_coefficients: [-0.28, 0.07, 0.0002, 0.00002]\n",
    ),
    (
        "kitti",
        "P0: 718.8 0 317.1 0 0 718.8 245.2 0 0 0 1 0\nP1: 718.8 0 317.1 -386 0 718.8 245.2 0 0 0 1 0\nTr: 1 0 0 0 0 1 0 0 0 0 1 0\n",
    ),
    ("numbers", "458.6,457.2,317.2,248.3,-0.28,0.07,0.0002,0.00002"),
    ("fisheye", "fisheye:300,300,320,240,0.1,0.01,0,0"),
    ("anchors", "a: &a [1, 2]\nintrinsics: *a\nresolution: &b {data: [640, 480], more: *a}\n"),
];

const CONFIGS: [(&str, &str); 4] = [
    ("empty", ""),
    (
        "all",
        "data_dir = \"/var/lib/waypost\"\ngrpc_address = \"0.0.0.0:7600\"\nhttp_address = \"[::1]:7601\"\nready_file = \"r.json\"\n\
         log = \"warn,waypost_server=debug\"\nlog_format = \"json\"\nallow_anonymous = true\nmap_memory_mib = 12\n\
         stranger_connections = 3\nstranger_connections_per_address = 2\nstranger_time_s = 7\nwrong_tokens_per_minute = 0\n\
         max_maps = 1\nmax_sessions = 2\nmax_kept_mib = 3\ncors_origins = [\"https://a.example:8443\", \"http://localhost\"]\n\
         tls_certificate = \"c.pem\"\ntls_key = \"k.pem\"\ntls_client_ca = \"ca.pem\"\n",
    ),
    ("misspelt", "data_dirr = \"x\"\n"),
    ("of-another-type", "map_memory_mib = \"many\"\ncors_origins = [1, {a = []}]\n"),
];

/// A vocabulary of DBoW2 or DBoW3: an inner node with two words, and one beside it.
fn dbow_yaml(descriptor: impl Fn(&str) -> String) -> String {
    let node = |(id, parent, byte): (u32, u32, u8)| {
        let descriptor = descriptor(&format!("{byte} ").repeat(32));
        format!(
            "      - {{ nodeId:{id}, parentId:{parent}, weight:1.,\n          descriptor:{descriptor} }}\n"
        )
    };
    let nodes: String = [(1, 0, 0), (2, 0, 255), (3, 1, 0), (4, 1, 1)].map(node).concat();
    let words: String = [2, 3, 4]
        .into_iter()
        .zip(0..)
        .map(|(node, id): (u32, u32)| format!("      - {{ wordId:{id}, nodeId:{node} }}\n"))
        .collect();
    let head = "   k: 9\n   L: 3\n   scoringType: 0\n   weightingType: 0\n";
    format!("%YAML:1.0\n---\nvocabulary:\n{head}   nodes:\n{nodes}   words:\n{words}")
}

fn orb() -> String {
    let node = |parent: u32, leaf: u8, byte: u8| {
        let bytes: Vec<String> = (0..32).map(|index| byte.wrapping_mul(index).to_string()).collect();
        format!("{parent} {leaf} {} 0.5\n", bytes.join(" "))
    };
    let nodes = [node(0, 0, 7), node(0, 1, 9), node(1, 1, 31), node(1, 1, 77)];
    format!("2 2 0 0\n{}", nodes.concat())
}

pub(super) fn seeds() -> Vec<Seed> {
    let of = |target, texts: &[(&'static str, &'static str)]| {
        let seeds = texts.iter().map(move |&(name, text)| Seed::new(target, name, text));
        seeds.collect::<Vec<_>>()
    };
    let mut seeds = of("g2o", &G2O);
    seeds.extend(of("tum", &TUM));
    seeds.extend(of("odometry_file", &ODOMETRY));
    seeds.extend(of("camera_file", &CAMERAS));
    seeds.extend(of("config", &CONFIGS));
    seeds.push(Seed::new("orb_vocabulary", "small", orb()));
    seeds.push(Seed::new("orb_vocabulary", "small.fbow", fixture("fabmap/tests/fixtures/small.fbow")));
    seeds.push(Seed::new("orb_vocabulary", "dbow2.yml", dbow_yaml(|bytes| format!("\"{bytes}\""))));
    seeds.push(Seed::new("orb_vocabulary", "dbow3.yml", dbow_yaml(|bytes| format!("dbw3 0 32 {bytes}"))));
    seeds
}
