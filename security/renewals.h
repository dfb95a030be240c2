#pragma once

#include <string>

#include <iotcloud/security/certificates.h>

/// Renews and revokes certificates. All functions throw Error.
namespace iotcloud::security {

inline constexpr int usual_days = 730;  ///< of a certificate

/// Which key a renewed certificate is for.
enum class RenewedKey {
  same,     ///< the holder's key stays; readers of the file find the old certificate or the new one, and both fit it
  new_one,  ///< a new key, too; who reads the two files in the moment between them finds a pair that does not fit
};

/// Makes a holder's certificate anew: name and uses as before, valid from now on. The certificate before it stays valid
/// until it expires or is revoked; the authority keeps a copy of it (earlier_file()) to be able to revoke it.
/// \throws Error for a holder whose certificate is revoked, if the key is to stay: who stole the key has it still
void renew_certificate(const Authority& authority, const std::string& holder, int days = usual_days,
                       RenewedKey key = RenewedKey::same);
/// The certificates that renewals replaced and that have not expired, of all holders.
std::string earlier_file(const Authority& authority);

/// The authority's list of certificates that are worth nothing any more.
std::string revocations_file(const Authority& authority);
/// Makes an empty list, if there is none.
void make_revocations(const Authority& authority);
/// Puts a holder's present certificate and the earlier ones on the list. Daemons read the list again on SIGHUP, or by
/// themselves.
void revoke_certificate(const Authority& authority, const std::string& holder);

/// The days until the first certificate in this file expires; negative: it has expired.
double days_left(const std::string& file);

}  // namespace iotcloud::security
