//! Messages as fields, and fields as bytes.

/// A value of a message.
#[derive(Clone)]
pub enum Field {
    /// The number of a header, which ROS 1 has alone.
    HeaderNumber,
    U8(u8),
    U32(u32),
    F64(f64),
    Text(String),
    Bytes(Vec<u8>),
}

pub type Fields = Vec<Field>;

/// Byte orders of CDR.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Order {
    Little,
    Big,
}

struct Cdr {
    bytes: Vec<u8>,
    order: Order,
}

impl Cdr {
    fn number<const SIZE: usize>(&mut self, mut little: [u8; SIZE]) {
        while !(self.bytes.len() - 4).is_multiple_of(SIZE) {
            self.bytes.push(0);
        }
        if self.order == Order::Big {
            little.reverse();
        }
        self.bytes.extend(little);
    }
}

/// As ROS 2 sends it.
pub fn cdr(fields: &[Field], order: Order) -> Vec<u8> {
    let head = if order == Order::Little { [0, 1, 0, 0] } else { [0, 0, 0, 0] };
    let mut cdr = Cdr { bytes: head.to_vec(), order };
    for field in fields {
        match field {
            Field::HeaderNumber => {}
            Field::U8(value) => cdr.number(value.to_le_bytes()),
            Field::U32(value) => cdr.number(value.to_le_bytes()),
            Field::F64(value) => cdr.number(value.to_le_bytes()),
            Field::Text(text) => {
                cdr.number((text.len() as u32 + 1).to_le_bytes());
                cdr.bytes.extend(text.as_bytes());
                cdr.bytes.push(0);
            }
            Field::Bytes(bytes) => {
                cdr.number((bytes.len() as u32).to_le_bytes());
                cdr.bytes.extend(bytes);
            }
        }
    }
    cdr.bytes
}

/// As ROS 1 sends it.
pub fn ros1(fields: &[Field]) -> Vec<u8> {
    let mut bytes = Vec::new();
    for field in fields {
        match field {
            Field::HeaderNumber => bytes.extend(7_u32.to_le_bytes()),
            Field::U8(value) => bytes.push(*value),
            Field::U32(value) => bytes.extend(value.to_le_bytes()),
            Field::F64(value) => bytes.extend(value.to_le_bytes()),
            Field::Text(text) => {
                bytes.extend((text.len() as u32).to_le_bytes());
                bytes.extend(text.as_bytes());
            }
            Field::Bytes(value) => {
                bytes.extend((value.len() as u32).to_le_bytes());
                bytes.extend(value);
            }
        }
    }
    bytes
}

fn header(stamp_ns: u64, frame: &str) -> Fields {
    vec![
        Field::HeaderNumber,
        Field::U32((stamp_ns / 1_000_000_000) as u32),
        Field::U32((stamp_ns % 1_000_000_000) as u32),
        Field::Text(frame.to_owned()),
    ]
}

fn numbers(values: &[f64]) -> impl Iterator<Item = Field> {
    values.iter().map(|value| Field::F64(*value))
}

pub fn compressed_image(stamp_ns: u64, format: &str, file: &[u8]) -> Fields {
    let mut fields = header(stamp_ns, "camera_optical");
    fields.extend([Field::Text(format.to_owned()), Field::Bytes(file.to_vec())]);
    fields
}

pub fn raw_image(
    stamp_ns: u64,
    encoding: &str,
    (width, height): (u32, u32),
    step: u32,
    data: &[u8],
) -> Fields {
    let mut fields = header(stamp_ns, "camera_optical");
    fields.extend([Field::U32(height), Field::U32(width), Field::Text(encoding.to_owned())]);
    fields.extend([Field::U8(0), Field::U32(step), Field::Bytes(data.to_vec())]);
    fields
}

pub fn camera_info(stamp_ns: u64, (width, height): (u32, u32), model: &str, distortion: &[f64]) -> Fields {
    let mut fields = header(stamp_ns, "camera_optical");
    fields.extend([Field::U32(height), Field::U32(width), Field::Text(model.to_owned())]);
    fields.push(Field::U32(distortion.len() as u32));
    fields.extend(numbers(distortion));
    fields.extend(numbers(&[50.0, 0.0, 4.0, 0.0, 51.0, 3.0, 0.0, 0.0, 1.0]));
    fields.extend(numbers(&[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]));
    fields.extend(numbers(&[40.0, 0.0, 4.5, 0.0, 0.0, 41.0, 3.5, 0.0, 0.0, 0.0, 1.0, 0.0]));
    fields.extend([0; 6].map(Field::U32));
    fields.push(Field::U8(0));
    fields
}

/// At x, not turned.
pub fn odometry(stamp_ns: u64, child: &str, x_m: f64) -> Fields {
    let mut fields = header(stamp_ns, "odom");
    fields.push(Field::Text(child.to_owned()));
    fields.extend(numbers(&[x_m, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]));
    fields.extend(numbers(&[0.0; 36]));
    fields.extend(numbers(&[0.0; 42]));
    fields
}

pub fn pose_stamped(stamp_ns: u64, x_m: f64) -> Fields {
    let mut fields = header(stamp_ns, "odom");
    fields.extend(numbers(&[x_m, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]));
    fields
}

/// Parent, child, position and orientation of each.
pub fn transforms(all: &[(&str, &str, [f64; 3], [f64; 4])]) -> Fields {
    transforms_at(1, all)
}

/// The same with a stamp.
pub fn transforms_at(stamp_ns: u64, all: &[(&str, &str, [f64; 3], [f64; 4])]) -> Fields {
    let mut fields = vec![Field::U32(all.len() as u32)];
    for (parent, child, position_m, orientation) in all {
        fields.extend(header(stamp_ns, parent));
        fields.push(Field::Text((*child).to_owned()));
        fields.extend(numbers(position_m));
        fields.extend(numbers(orientation));
    }
    fields
}
