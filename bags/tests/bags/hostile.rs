//! Bags that are damaged, or lie: what is wrong is named with its byte, and memory stays bounded.

use std::path::Path;

use waypost_bags::{Bag, Wanted};

use crate::reading::{frames, open};
use crate::writing::mcap_file::mcap;
use crate::writing::messages::{Field, Order};
use crate::writing::ros1_file::{Chunks, bag_header, chunk, record, ros1_bag};
use crate::writing::sqlite_file::{Stored, sqlite};
use crate::writing::{Folder, drive};

fn refused(path: &Path) -> String {
    Bag::open(path, &mut |_, _| {}).unwrap_err().to_string()
}

fn whole() -> Vec<u8> {
    mcap(&drive(), Some(mcap::Compression::Zstd), Order::Little)
}

#[test]
fn what_is_before_a_cut_is_read() {
    let folder = Folder::new();
    let plain = mcap(&drive(), None, Order::Little);
    let files = [("cut.mcap", plain), ("cut.bag", ros1_bag(&drive(), Chunks::None))];
    for (name, file) in files {
        let most = file.len() * 6 / 10;
        let bag = open(&folder.file(name, &file[..most]));
        let [cut] = bag.cut_off() else { panic!("{:?}", bag.cut_off()) };
        assert_eq!(cut.at_byte, most as u64, "{name}");
        let choice = bag.choose(&Wanted::default()).unwrap();
        let count = frames(&bag, &choice, 0).len();
        assert!((1..4).contains(&count), "{name}: {count}");
    }
    // A bag that says where its index is and ends before.
    let bag = open(&folder.file("no_index.bag", &bag_header(1_000_000)));
    assert_eq!(bag.cut_off().len(), 1);
}

#[test]
fn a_wrong_crc_is_named() {
    let folder = Folder::new();
    let mut file = mcap(&drive(), None, Order::Little);
    // A pixel of an image.
    let place = file.windows(4).position(|window| window == b"IDAT").unwrap() + 8;
    file[place] ^= 1;
    let told = refused(&folder.file("drive.mcap", &file));
    assert!(told.contains("drive.mcap is damaged at byte"), "{told}");
    assert!(told.contains("the CRC of a chunk is") && told.contains("`mcap recover` may save"), "{told}");
}

#[test]
fn what_is_no_bag_says_so() {
    let folder = Folder::new();
    let told = refused(&folder.file("text.mcap", b"no bag at all"));
    assert!(told.ends_with("it does not begin as MCAP does; check the file, or record it anew"), "{told}");
    assert!(refused(&folder.file("empty.mcap", b"")).contains("does not begin as MCAP does"));
    assert!(refused(&folder.file("old.bag", b"#ROSRECORD V1.1\n")).contains("`rosbag migrate`"));
    assert!(refused(&folder.file("text.db3", b"no database")).contains("does not begin as SQLite does"));
    assert!(refused(&folder.file("text.zip", b"")).contains("bags end in .mcap, .db3 or .bag"));
    assert!(refused(&folder.path().join("nowhere.mcap")).contains("there is no such file or folder"));
    let metadata = |text: &str| {
        let folder = Folder::new();
        folder.file("metadata.yaml", text.as_bytes());
        refused(folder.path())
    };
    let of = |name: &str| format!("rosbag2_bagfile_information:\n  relative_file_paths: [{name}]\n");
    assert!(metadata(&of("a.db3")).contains("it names a.db3, which is not there"));
    assert!(metadata(&of("../a.db3")).contains("it names ../a.db3, which is not in its folder"));
    assert!(metadata("- 1\n").contains("metadata.yaml is no bag: "));
    let mut bomb = "a: &a [x, x, x, x, x, x, x, x, x]\n".to_owned();
    for (name, before) in "bcdefghi".chars().zip("abcdefgh".chars()) {
        bomb += &format!("{name}: &{name} [{}]\n", vec![format!("*{before}"); 9].join(", "));
    }
    assert!(metadata(&bomb).contains("metadata.yaml is no bag: "));
}

#[test]
fn a_database_that_is_damaged_is_refused() {
    let folder = Folder::new();
    let path = folder.path().join("drive.db3");
    sqlite(&path, &drive(), Stored::Plain);
    let mut file = std::fs::read(&path).unwrap();
    let most = file.len() / 2;
    let told = refused(&folder.file("cut.db3", &file[..most]));
    assert!(told.contains("cannot be read as a rosbag2 database"), "{told}");
    file[4096..].fill(0xee);
    assert!(refused(&folder.file("noise.db3", &file)).contains("cannot be read as a rosbag2 database"));
    let other = folder.path().join("other.db3");
    rusqlite::Connection::open(&other).unwrap().execute_batch("CREATE TABLE things(id)").unwrap();
    assert!(refused(&other).contains("it has no tables topics and messages"));
    let bomb = zstd::encode_all([b"SQLite format 3\0".as_slice(), &vec![0; 80 << 20]].concat().as_slice(), 1);
    let told = refused(&folder.file("bomb.db3.zstd", &bomb.unwrap()));
    assert!(told.contains("it decompresses to more than 67108864 bytes"), "{told}");
}

#[test]
fn chunks_that_lie_about_their_size_are_refused() {
    let folder = Folder::new();
    let bag = |chunk: Vec<u8>| [bag_header(0), chunk].concat();
    let filler = record(&[("op", &[4])], &[0; 100]);
    let less = chunk(&filler, Chunks::Lz4, filler.len() as u32 - 1);
    let told = refused(&folder.file("less.bag", &bag(less)));
    assert!(told.contains("damaged at byte") && told.contains("a chunk ends in the middle"), "{told}");
    let more = chunk(&filler, Chunks::Lz4, filler.len() as u32 + 1);
    assert!(refused(&folder.file("more.bag", &bag(more))).contains("bytes and has"));
    let two = chunk(&[filler.clone(), filler.clone()].concat(), Chunks::Bz2, filler.len() as u32);
    assert!(refused(&folder.file("two.bag", &bag(two))).contains("and has more"));
    let huge = chunk(&filler, Chunks::None, u32::MAX);
    assert!(refused(&folder.file("huge.bag", &bag(huge))).contains("chunks of up to 1073741824 are read"));
    // 32 MiB of zeros in some hundred bytes.
    let bomb = vec![0; 32 << 20];
    let bomb = bag(chunk(&bomb, Chunks::Bz2, bomb.len() as u32));
    assert!(bomb.len() < 10_000, "{}", bomb.len());
    assert!(refused(&folder.file("bomb.bag", &bomb)).contains("a record's head has no field op"));
}

#[test]
fn records_that_lie_about_their_size_are_refused() {
    let folder = Folder::new();
    let mut file = whole();
    // The length of the first record behind the magic: it ends behind the file.
    file[9..17].copy_from_slice(&u64::MAX.to_le_bytes());
    let bag = open(&folder.file("long.mcap", &file));
    assert_eq!((bag.topics().len(), bag.cut_off().len()), (0, 1));
    let mut file = b"\x89MCAP0\r\n\x05".to_vec();
    file.extend(3_u64.to_le_bytes());
    file.extend([0; 3]);
    let told = refused(&folder.file("short.mcap", &file));
    assert!(told.contains("damaged at byte 8: a message has 3 bytes, less than its head"), "{told}");
    let mut head = b"#ROSBAG V2.0\n".to_vec();
    head.extend(u32::MAX.to_le_bytes());
    let told = refused(&folder.file("head.bag", &head));
    assert!(told.contains("damaged at byte 13: the head of a record says it has 4294967295 bytes"), "{told}");
}

#[test]
fn messages_that_lie_are_left_out_and_named() {
    let mut messages = drive();
    // The second image says it has more bytes than the message: the stamp comes first, then two texts.
    let image = messages.iter().position(|message| message.topic.starts_with("/camera/image")).unwrap();
    let lying = image + 3;
    assert!(messages[lying].topic.starts_with("/camera/image"));
    messages[lying].fields.pop();
    messages[lying].fields.push(Field::U32(u32::MAX));
    let folder = Folder::new();
    let bag = open(&folder.file("drive.mcap", &mcap(&messages, None, Order::Little)));
    let choice = bag.choose(&Wanted::default()).unwrap();
    assert_eq!(choice.stamps_ns.iter().map(Option::is_some).collect::<Vec<_>>(), [true, false, true, true]);
    let left_out = choice.left_out.clone().unwrap();
    assert_eq!((left_out.count, left_out.first_number), (1, 2));
    let told = left_out.first_problem.to_string();
    assert_eq!(told, "at byte 44: a length says 4294967295 elements, and 0 bytes are left");
    let numbers: Vec<u64> = frames(&bag, &choice, 0).iter().map(|frame| frame.number).collect();
    assert_eq!(numbers, [1, 3, 4]);
}

#[test]
fn odometry_that_is_no_pose_is_left_out() {
    let mut messages = drive();
    for message in messages.iter_mut().filter(|message| message.topic == "/odom") {
        message.fields[5] = Field::F64(f64::NAN);
    }
    let folder = Folder::new();
    let bag = open(&folder.file("drive.mcap", &mcap(&messages, None, Order::Little)));
    let odometry = bag.topics().iter().find(|topic| topic.name == "/odom").unwrap();
    let left_out = odometry.left_out.clone().unwrap();
    assert_eq!((odometry.readable(), left_out.count), (0, 8));
    assert!(left_out.first_problem.to_string().contains("its pose is none"));
    let choice = bag.choose(&Wanted::default()).unwrap();
    assert!(frames(&bag, &choice, 0).iter().all(|frame| frame.pose.is_none()));
}
