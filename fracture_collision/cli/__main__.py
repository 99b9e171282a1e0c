from fracture_collision.cli import main

if __name__ == "__main__":
    main()
