package iotcloud.storm;

import org.apache.storm.topology.ReportedFailedException;

/**
 * A grouping of C++ chose no task for a tuple, because it threw, or because the tuple has a value that C++ cannot have. Components of
 * C++ fail the tuple that they execute, and so does Storm for a basic bolt of Java. It has no Java stack, which would tell nothing.
 */
public final class GroupingError extends ReportedFailedException {
  private static final long serialVersionUID = 1;

  GroupingError(String text) {
    super(text);
  }

  @Override
  public synchronized Throwable fillInStackTrace() {
    return this;
  }
}
