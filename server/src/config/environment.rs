//! Variables of the environment that configure a server, and those of the same prefix that do not.

use super::Config;
use std::collections::HashMap;
use std::ffi::OsString;

/// Variables of the same prefix that are not the server's: where clients find it, and where recordings are.
const NOT_OF_SERVERS: [&str; 4] = ["MONOSLAM_SERVER", "MONOSLAM_DATA", "MONOSLAM_TOKEN", "MONOSLAM_CA"];

/// The environment as far as it may configure a server.
pub fn of_server(variables: impl Iterator<Item = (OsString, OsString)>) -> HashMap<String, String> {
    variables
        .filter_map(|(name, value)| Some((name.into_string().ok()?, value.into_string().ok()?)))
        .filter(|(name, _)| !NOT_OF_SERVERS.contains(&name.as_str()) && !is_of_orchestrator(name))
        .collect()
}

/// Whether an orchestrator sets the variable for a service that is called like this program, or begins like
/// it: `MONOSLAM_SERVICE_HOST`, `MONOSLAM_PORT`, `MONOSLAM_PORT_50051_TCP_ADDR`,
/// `MONOSLAM_SERVER_SERVICE_PORT_HTTP`; and the links of containers, `MONOSLAM_NAME`, `MONOSLAM_ENV_X`. No
/// field of the configuration is called so.
fn is_of_orchestrator(name: &str) -> bool {
    let Some(name) = name.strip_prefix("MONOSLAM_") else { return false };
    // With a mark before it, each part is found at the beginning as well.
    let name = format!("_{name}");
    let is_port = |(_, rest): (&str, &str)| {
        let number = rest.trim_start_matches('_').split('_').next().unwrap_or_default();
        rest.is_empty()
            || (rest.starts_with('_') && !number.is_empty() && number.bytes().all(|c| c.is_ascii_digit()))
    };
    name.ends_with("_SERVICE_HOST")
        || name.contains("_SERVICE_PORT")
        || name.split_once("_PORT").is_some_and(is_port)
        || name.ends_with("_NAME")
        || name.contains("_ENV_")
}
/// Those of these variables of the environment that name no field.
pub fn unknown_variables(names: impl Iterator<Item = String>) -> Vec<String> {
    let fields = serde_json::to_value(Config::default()).unwrap_or_default();
    let is_unknown = |name: &String| {
        let field = name.strip_prefix("MONOSLAM_").map(|field| field.to_lowercase().replace("__", "/"));
        field.is_some_and(|field| fields.pointer(&format!("/{field}")).is_none())
    };
    names.filter(is_unknown).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn variables_of_clients_and_orchestrators_do_not_configure_a_server() {
        let names = [
            "MONOSLAM_DATA",
            "MONOSLAM_SERVER",
            "MONOSLAM_LOG",
            "MONOSLAM_PORT",
            "MONOSLAM_PORT_50051_TCP",
            "MONOSLAM_PORT_50051_TCP_ADDR",
            "MONOSLAM_SERVICE_HOST",
            "MONOSLAM_SERVICE_PORT",
            "MONOSLAM_SERVICE_PORT_GRPC",
            "MONOSLAM_SERVER_SERVICE_HOST",
            "MONOSLAM_SERVER_PORT",
            "MONOSLAM_SERVER_PORT_8080_TCP_PROTO",
            "MONOSLAM_NAME",
            "MONOSLAM_ENV_PATH",
        ];
        let variables = names.map(|name| (OsString::from(name), OsString::from("json")));
        let left: Vec<String> = of_server(variables.into_iter()).into_keys().collect();
        assert_eq!(left, ["MONOSLAM_LOG"]);
    }

    #[test]
    fn no_field_is_taken_for_a_variable_of_an_orchestrator() {
        let fields = serde_json::to_value(Config::default()).unwrap();
        let mut names = Vec::new();
        for (name, value) in fields.as_object().unwrap() {
            match value.as_object() {
                Some(inner) => names.extend(inner.keys().map(|field| format!("MONOSLAM_{name}__{field}"))),
                None => names.push(format!("MONOSLAM_{name}")),
            }
        }
        assert!(names.len() > 15, "{names:?}");
        for name in names {
            assert!(!is_of_orchestrator(&name.to_uppercase()), "{name}");
        }
        assert!(!is_of_orchestrator("MONOSLAM_DATA_DRI"), "what is mistyped is refused");
        let given = ["MONOSLAM_DATA_DRI", "MONOSLAM_DATA_DIR", "MONOSLAM_LIMITS__MAX_SESIONS", "HOME"];
        let unknown = unknown_variables(given.into_iter().map(str::to_owned));
        assert_eq!(unknown, ["MONOSLAM_DATA_DRI", "MONOSLAM_LIMITS__MAX_SESIONS"]);
    }
}
