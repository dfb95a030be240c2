#pragma once

#include <string>
#include <vector>

namespace iotcloud::master::cli {

/// The options that a deployment may set for a channel: the driver host reads them from properties named
/// `channel.<channel>.<option>` (gateway/README.md). They are checked here too, so that a mistake is found before
/// anything is ordered. Whether the driver has such a channel only its gateway knows.
const std::vector<std::string>& channel_options();

/// Says what is wrong with an option or its value, and how to mend it. \return empty: nothing is wrong
std::string channel_option_problem(const std::string& option, const std::string& value);

/// Says why a spool option does not fit the channel; empty: it fits. \param when_full that option of the channel;
/// empty: it is not set.
std::string spool_option_problem(const std::string& option, const std::string& when_full);

/// The name of the property that sets the option.
std::string channel_property(const std::string& channel, const std::string& option);

/// Says what is wrong with such a property (of the form `<channel>.<option>`, as in `--channel`) and its value; empty:
/// nothing.
std::string channel_setting_problem(const std::string& setting, const std::string& value);

}  // namespace iotcloud::master::cli
