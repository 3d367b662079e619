//! The INI file: what it has to say, and how that gets into a file that is there.

pub mod edit;
mod wanted;

pub use wanted::{CUSTOM_HAL, CUSTOM_POST_GUI_HAL, MAIN_HAL, POST_GUI_HAL, TOOL_TABLE, wanted};

/// A line of an INI file: its section, key and value.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Entry {
    /// As in `JOINT_0`.
    pub section: String,
    /// As in `SCALE`.
    pub key: String,
    /// To the end of the line.
    pub value: String,
}

impl Entry {
    /// The line.
    pub fn line(&self) -> String {
        format!("{} = {}", self.key, self.value)
    }

    /// LinuxCNC reads every line with this key, not only the first.
    pub fn is_list(&self) -> bool {
        matches!(
            self.key.as_str(),
            "HALFILE" | "POSTGUI_HALFILE" | "PROGRAM_EXTENSION"
        )
    }
}
