//! Where a demo reads its sequence, and where it leaves its data.

use std::path::{Path, PathBuf};

use crate::failure::Failure;

/// A file that tells the folder of the sequence from others of its name.
const LABELS: &str = "sequence/loops.csv";

/// The file of this name in the folder of the running program.
pub(super) fn beside_program(name: &str) -> Result<PathBuf, Failure> {
    let this = std::env::current_exe().map_err(Failure::file("find", Path::new("the running program")))?;
    Ok(this.with_file_name(name))
}

/// The folder of the sequence that ships.
pub(super) fn shipped_sequence() -> Result<PathBuf, Failure> {
    let looked_at = [
        PathBuf::from("demo"),
        // Installed, or unpacked: bin and share lie beside each other.
        beside_program("../share/waypost/demo")?,
        // Built in a clone: target/release.
        beside_program("../../demo")?,
    ];
    first_with_labels(&looked_at)
}

fn first_with_labels(folders: &[PathBuf]) -> Result<PathBuf, Failure> {
    let found = folders.iter().find(|folder| folder.join(LABELS).is_file());
    found.map(|folder| folder.join("sequence")).ok_or_else(|| {
        let folders: Vec<String> = folders.iter().map(|folder| folder.display().to_string()).collect();
        Failure::Unfit(format!(
            "the recorded sequence is not there (looked for {LABELS} in {}); name its folder with --data, or see a \
             simulated robot: --world office",
            folders.join(", ")
        ))
    })
}

/// How many folders of earlier demos are looked past.
const MOST_KEPT: u32 = 1000;

/// Makes the folder for data: the one that is `asked` for, or the first beside `usual` that is not there. What is
/// there stays: people go on with the server of a demo, and make maps of their own in its folder.
pub(super) fn make_data_dir(asked: Option<&Path>, usual: &Path) -> Result<PathBuf, Failure> {
    let folder = match asked {
        Some(asked) if is_used(asked)? => {
            return Err(Failure::Unfit(format!(
                "{} is there already, and a demo removes nothing; name another folder with --keep-data, or leave that out",
                asked.display()
            )));
        }
        Some(asked) => asked.to_owned(),
        None => unused(usual)?,
    };
    std::fs::create_dir_all(&folder).map_err(Failure::file("create", &folder))?;
    Ok(folder)
}

fn unused(usual: &Path) -> Result<PathBuf, Failure> {
    let name = usual.to_string_lossy();
    let numbered = (2..=MOST_KEPT).map(|number| PathBuf::from(format!("{name}-{number}")));
    for folder in std::iter::once(usual.to_owned()).chain(numbered) {
        if !is_used(&folder)? {
            return Ok(folder);
        }
    }
    Err(Failure::Unfit(format!(
        "{name} to {name}-{MOST_KEPT} are there already; remove those that you do not need, or name a folder with \
         --keep-data"
    )))
}

fn is_used(path: &Path) -> Result<bool, Failure> {
    if !path.is_dir() {
        return Ok(path.exists());
    }
    let mut entries = std::fs::read_dir(path).map_err(Failure::file("list", path))?;
    Ok(entries.next().is_some())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sequence_is_where_its_labels_are() {
        let parent = tempfile::tempdir().unwrap();
        let [someones, ours] = ["someones", "ours"].map(|name| parent.path().join(name));
        std::fs::create_dir_all(someones.join("sequence")).unwrap();
        let folders = [someones, ours.clone()];
        let missing = first_with_labels(&folders).unwrap_err().to_string();
        assert!(missing.contains("--data") && missing.contains("--world"), "{missing}");
        std::fs::create_dir_all(ours.join("sequence")).unwrap();
        std::fs::write(ours.join(LABELS), b"x").unwrap();
        assert_eq!(first_with_labels(&folders).unwrap(), ours.join("sequence"));
    }

    #[test]
    fn what_an_earlier_demo_left_stays() {
        let parent = tempfile::tempdir().unwrap();
        let usual = parent.path().join("demo-data");
        let first = make_data_dir(None, &usual).unwrap();
        assert_eq!(first, usual);
        // Somebody goes on with the server of the demo.
        std::fs::write(first.join("mine"), b"x").unwrap();
        let second = make_data_dir(None, &usual).unwrap();
        assert_eq!(second, parent.path().join("demo-data-2"));
        std::fs::write(second.join("waypost.sqlite"), b"x").unwrap();
        assert_eq!(make_data_dir(None, &usual).unwrap(), parent.path().join("demo-data-3"));
        let refused = make_data_dir(Some(&first), &usual).unwrap_err().to_string();
        assert!(refused.contains("a demo removes nothing"), "{refused}");
        assert!(first.join("mine").exists());
    }

    #[test]
    fn a_file_is_no_folder_for_data() {
        let parent = tempfile::tempdir().unwrap();
        let file = parent.path().join("thesis");
        std::fs::write(&file, b"x").unwrap();
        assert!(matches!(make_data_dir(Some(&file), Path::new("demo-data")), Err(Failure::Unfit(_))));
        let empty = parent.path().join("empty");
        std::fs::create_dir(&empty).unwrap();
        assert_eq!(make_data_dir(Some(&empty), Path::new("demo-data")).unwrap(), empty);
    }
}
