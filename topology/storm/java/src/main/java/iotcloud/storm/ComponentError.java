package iotcloud.storm;

/** An error of a C++ component, as Storm shows it. It has no Java stack, which would tell nothing. */
public final class ComponentError extends RuntimeException {
  private static final long serialVersionUID = 1;

  ComponentError(String text) {
    super(text, null, false, false);
  }
}
