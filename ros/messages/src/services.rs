//! The services of ROS 2 that robots call without a package of Waypost's.

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

/// A service of ROS.
pub trait Service: Send + Sync + 'static {
    /// Its type as ROS names it, as in `std_srvs/srv/Trigger`.
    const TYPE: &'static str;
    /// What is asked.
    type Request: Serialize + DeserializeOwned + Send + 'static;
    /// What is answered.
    type Response: Serialize + DeserializeOwned + Send + 'static;
}

/// What ROS sends where there is nothing to say: IDL has no empty structures.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Nothing {
    structure_needs_at_least_one_member: u8,
}

/// Whether something was done, and what is to be said of that.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Done {
    /// Whether it was.
    pub success: bool,
    /// What became of it, or why not.
    pub message: String,
}

/// std_srvs/Trigger
pub struct Trigger;

impl Service for Trigger {
    const TYPE: &'static str = "std_srvs/srv/Trigger";
    type Request = Nothing;
    type Response = Done;
}

/// What is asked of std_srvs/SetBool.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Switch {
    /// On or off.
    pub data: bool,
}

/// std_srvs/SetBool
pub struct SetBool;

impl Service for SetBool {
    const TYPE: &'static str = "std_srvs/srv/SetBool";
    type Request = Switch;
    type Response = Done;
}

/// The kinds of rcl_interfaces/ParameterType that are used here.
const NOT_SET: u8 = 0;
const BOOL: u8 = 1;
const STRING: u8 = 4;

/// rcl_interfaces/ParameterValue
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ParameterValue {
    kind: u8,
    bool_value: bool,
    integer_value: i64,
    double_value: f64,
    string_value: String,
    byte_array_value: Vec<u8>,
    bool_array_value: Vec<bool>,
    integer_array_value: Vec<i64>,
    double_array_value: Vec<f64>,
    string_array_value: Vec<String>,
}

impl ParameterValue {
    /// A text.
    #[must_use]
    pub fn of_text(text: &str) -> Self {
        Self { kind: STRING, string_value: text.to_owned(), ..Self::default() }
    }

    /// On or off.
    #[must_use]
    pub fn of_switch(is_on: bool) -> Self {
        Self { kind: BOOL, bool_value: is_on, ..Self::default() }
    }

    /// The text, if it is one.
    #[must_use]
    pub fn text(&self) -> Option<&str> {
        (self.kind == STRING).then_some(self.string_value.as_str())
    }

    /// Whether it is on, if it is a switch.
    #[must_use]
    pub fn switch(&self) -> Option<bool> {
        (self.kind == BOOL).then_some(self.bool_value)
    }

    /// Whether it has no value.
    #[must_use]
    pub fn is_not_set(&self) -> bool {
        self.kind == NOT_SET
    }
}

/// rcl_interfaces/Parameter
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Parameter {
    /// Within its node.
    pub name: String,
    /// What it is to be.
    pub value: ParameterValue,
}

/// What is asked of rcl_interfaces/SetParameters.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Wanted {
    /// In any order.
    pub parameters: Vec<Parameter>,
}

/// rcl_interfaces/SetParametersResult
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Set {
    /// Whether it was.
    pub successful: bool,
    /// Why not.
    pub reason: String,
}

/// What rcl_interfaces/SetParameters answers.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Results {
    /// Of each parameter, in the order of the request.
    pub results: Vec<Set>,
}

/// rcl_interfaces/SetParameters
pub struct SetParameters;

impl Service for SetParameters {
    const TYPE: &'static str = "rcl_interfaces/srv/SetParameters";
    type Request = Wanted;
    type Response = Results;
}

/// What is asked of rcl_interfaces/GetParameters.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Names {
    /// Of parameters.
    pub names: Vec<String>,
}

/// What rcl_interfaces/GetParameters answers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Values {
    /// Of each parameter, in the order of the request; not set for those that are not known.
    pub values: Vec<ParameterValue>,
}

/// rcl_interfaces/GetParameters
pub struct GetParameters;

impl Service for GetParameters {
    const TYPE: &'static str = "rcl_interfaces/srv/GetParameters";
    type Request = Names;
    type Response = Values;
}

/// What is asked of rcl_interfaces/ListParameters.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Listed {
    /// Only parameters that begin with one of these; empty for all.
    pub prefixes: Vec<String>,
    /// How many dots a name may have; 0 for any.
    pub depth: u64,
}

/// What rcl_interfaces/ListParameters answers.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct List {
    /// Names of parameters.
    pub names: Vec<String>,
    /// What stands before dots in them.
    pub prefixes: Vec<String>,
}

/// rcl_interfaces/ListParameters
pub struct ListParameters;

impl Service for ListParameters {
    const TYPE: &'static str = "rcl_interfaces/srv/ListParameters";
    type Request = Listed;
    type Response = List;
}
