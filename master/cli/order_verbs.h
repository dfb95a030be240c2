#pragma once

#include <iotcloud/master/cli/verb.h>

namespace iotcloud::master::cli {

/// Prints the answer to an order: its outcomes, or why it was refused. \return the exit status.
/// \param text one line for people that JSON and YAML also contain. \param ok whether everything that was asked for is
/// done
int show_order(Call& call, const OrderResult& result, const std::string& text, bool ok);
int show_order(Call& call, const OrderResult& result);

}  // namespace iotcloud::master::cli
