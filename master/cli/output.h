#pragma once

#include <iotcloud/config/output/output.h>
#include <iotcloud/config/output/watch.h>

namespace iotcloud::master::cli {

// NOLINTBEGIN(misc-unused-using-decls): the verbs use them
using config::output::age;
using config::output::Format;
using config::output::interrupt;
using config::output::moment;
using config::output::now_ms;
using config::output::pause;
using config::output::print;
using config::output::print_data;
using config::output::print_table;
using config::output::print_yaml;
using config::output::printable;
using config::output::watch;
// NOLINTEND(misc-unused-using-decls)

}  // namespace iotcloud::master::cli
