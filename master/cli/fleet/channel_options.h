#pragma once

#include <string>
#include <vector>

namespace iotcloud::master::cli {

/// What a deployment may say of a channel: the options that the driver host reads from properties named
/// `channel.<channel>.<option>` (gateway/README.md). Checked here too, so that a mistake is found before anything is
/// ordered; whether the driver has such a channel only its gateway knows.
const std::vector<std::string>& channel_options();

/// What is wrong with an option or its value, and what would be right; empty: nothing.
std::string channel_option_problem(const std::string& option, const std::string& value);

/// What is wrong with the options of one channel together; empty: nothing. \param when_full as said; empty: not said.
std::string spool_option_problem(const std::string& option, const std::string& when_full);

/// The property that says it.
std::string channel_property(const std::string& channel, const std::string& option);

/// What is wrong with such a property (of the form `<channel>.<option>`, as in `--channel`) and its value; empty:
/// nothing.
std::string channel_setting_problem(const std::string& setting, const std::string& value);

}  // namespace iotcloud::master::cli
