#pragma once

#include <string>
#include <vector>

namespace iotcloud::master::cli {

/// The options that a deployment may set for a channel: the driver host reads them from properties named
/// `channel.<channel>.<option>` (gateway/README.md). They are checked here too, so that a mistake is found before
/// anything is ordered. Whether the driver has such a channel only its gateway knows.
const std::vector<std::string>& channel_options();

/// What is wrong with an option or its value, and what would be right; empty: nothing.
std::string channel_option_problem(const std::string& option, const std::string& value);

/// What is wrong with the options of one channel together; empty: nothing. \param when_full that option of the channel;
/// empty: it is not set.
std::string spool_option_problem(const std::string& option, const std::string& when_full);

/// The name of the property that sets the option.
std::string channel_property(const std::string& channel, const std::string& option);

/// What is wrong with such a property (of the form `<channel>.<option>`, as in `--channel`) and its value; empty:
/// nothing.
std::string channel_setting_problem(const std::string& setting, const std::string& value);

}  // namespace iotcloud::master::cli
